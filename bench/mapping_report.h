#pragma once

#include <iosfwd>
#include <optional>
#include <string>
#include <vector>

#include "bench/machine.h"

namespace corvid {

/// One piece of work of mapping. What does not apply to it is absent.
struct MappingRow {
  std::string workload;
  std::optional<double> rays;            ///< of one view
  std::optional<int> views;              ///< compared with a view, or depth maps used
  std::optional<int> depths;             ///< samples of a ray
  std::optional<double> seconds;         ///< median wall time of one view
  std::optional<double> cpu_s;           ///< mean processor time of it, all threads
  std::optional<double> share_of_peak;   ///< of the single-precision peak, in the weighted sums
  std::optional<double> answered;        ///< of the rays, or of the pixels with truth
  std::optional<double> within_1;        ///< of the answers: error below 1 %
  std::optional<double> within_2;        ///< below 2 %
  std::optional<double> median_error_m;  ///< absolute
  std::optional<double> voxels;
  std::optional<double> graph_s, maxflow_s;
  std::optional<double> peak_mb;
  std::optional<double> unpaired_sides;  ///< of the surface's faces; 0: closed
};

struct MappingReport {
  BenchMachine machine;
  double peak_gflops = 0;  ///< median; 0: not measured
  std::vector<MappingRow> rows;
  bool interrupted = false;
};

/// The table as text.
void print(const MappingReport& report, std::ostream& out);
/// A JSON array with one object per row (docs/formats.md).
[[nodiscard]] std::string json_rows(const MappingReport& report);

}  // namespace corvid
