#pragma once

#include <memory>
#include <stop_token>
#include <vector>

#include "bench/ncc_report.h"
#include "corvid/error.h"
#include "kernels/device.h"

namespace corvid {

struct NccBenchOptions {
  std::vector<int> templates_px{3, 5, 7, 11, 13, 15, 25};  ///< sides; odd, 3 to 31
  std::vector<int> images_px{250, 500, 1024, 3000, 5000};  ///< sides; not below the templates'
  std::vector<NccTable> tables{std::begin(kNccTables), std::end(kNccTables)};
  int runs = 11;  ///< of each work; > 0
};
/// Everything that is wrong with the options, as one invalid_argument.
[[nodiscard]] Expected<void> validate(const NccBenchOptions& options);

/// Measures correlation on `device` against OpenCV on the same data in this process, and the
/// machine's peak between the rows. Kernels are built before anything is timed. Progress goes to
/// log().
/// @param report  gets each row as it is finished; valid, too, after an error or a stop.
/// Errors: invalid_argument; device.
[[nodiscard]] Expected<void> run_ncc_bench(const std::shared_ptr<Device>& device,
                                           const NccBenchOptions& options,
                                           const std::stop_token& stop, NccReport& report);

}  // namespace corvid
