#pragma once

#include <iosfwd>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "bench/machine.h"
#include "bench/timing.h"

namespace corvid {

enum class NccTable {
  dense,     ///< every coefficient of an image
  strips,    ///< thousands of long windows, peaks out: matching
  windows,   ///< a thousand small windows, peaks out: tracking
  flavours,  ///< weights, float images, templates that are not square
  features,  ///< corners and pyramid
};
inline constexpr NccTable kNccTables[] = {NccTable::dense, NccTable::strips, NccTable::windows,
                                          NccTable::flavours, NccTable::features};
[[nodiscard]] std::string_view to_string(NccTable table);

/// One measured piece of work.
struct NccRow {
  NccTable table = NccTable::dense;
  std::string name;
  int template_width_px = 0, template_height_px = 0;  ///< 0: there is no template
  int image_width_px = 0, image_height_px = 0;
  int runs = 0;
  double coefficients = 0;  ///< of one run
  Timing corvid;
  std::optional<Timing> opencv;  ///< the same work
  /// Median with what the matcher keeps of an image (denominators) from an earlier run.
  std::optional<double> kept_ms;
  std::optional<double> upload_ms;           ///< median of copying the image to the device
  std::optional<double> largest_difference;  ///< of a coefficient from OpenCV's
  std::optional<double> share_of_dense;      ///< of the dense rate, measured in turn

  [[nodiscard]] std::optional<double> ratio() const;  ///< OpenCV's median time over ours
  [[nodiscard]] double gcoefficients_per_s() const;
  [[nodiscard]] double gflops() const;  ///< numerators only: 2 per template pixel and coefficient
};

struct NccReport {
  BenchMachine machine;
  double peak_gflops = 0, copy_gbytes_s = 0;  ///< medians; 0: not measured
  int peak_measurements = 0;
  int runs = 0;
  std::vector<NccRow> rows;
  bool interrupted = false;
};

/// Coefficients further from OpenCV's than this are wrong: its own single precision sums err by up
/// to about 1e-3 with the smallest templates.
inline constexpr double kLargestDifference = 5e-3;
/// One sentence per row beyond it.
[[nodiscard]] std::vector<std::string> disagreements(const NccReport& report);

/// The tables as text.
void print(const NccReport& report, std::ostream& out);
/// A JSON array with one object per row (docs/formats.md).
[[nodiscard]] std::string json_rows(const NccReport& report);

}  // namespace corvid
