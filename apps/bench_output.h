#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <optional>
#include <ostream>
#include <string>

#include "apps/opencl_trouble.h"
#include "apps/program.h"
#include "corvid/error.h"
#include "io/atomic_file.h"
#include "kernels/device.h"

namespace corvid {

/// What every `corvid bench` has: the device it measures, and where its rows go.
struct BenchOutput {
  std::string device_name = "auto";
  std::optional<std::string> json;

  /// Adds --json and --device to a command.
  void add_to(CLI::App& command) {
    command.add_option("--json", json, "File for the rows, as a JSON array");
    command.add_option("--device", device_name, "auto, cpu, gpu, or a number from `corvid doctor`")
        ->envname("CORVID_DEVICE")
        ->capture_default_str();
  }
  /// Whether the rows can be written: found out before minutes of measuring.
  [[nodiscard]] Expected<void> check() const {
    return json ? check_file_writable(*json) : Expected<void>();
  }
  [[nodiscard]] Expected<std::shared_ptr<Device>> open_device() const {
    return open_explained([&] { return Device::open(device_name); });
  }
  /// Prints and writes what was measured, whatever became of the measuring (`done`) after it; if
  /// that failed at once, the error alone.
  /// Report: has print(), json_rows(), `rows` and `interrupted`.
  template <class Report>
  [[nodiscard]] Expected<ExitCode> keep(const Report& report, const Expected<void>& done,
                                        Context& context) const {
    if (!done && report.rows.empty()) return tl::unexpected(done.error());
    print(report, context.out);
    if (json) {
      if (auto written = write_file_atomically(*json, json_rows(report)); !written)
        return tl::unexpected(written.error());
    }
    if (!done) return tl::unexpected(done.error());
    return report.interrupted ? ExitCode::interrupted : ExitCode::ok;
  }
};

}  // namespace corvid
