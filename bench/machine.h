#pragma once

#include <iosfwd>
#include <string>

#include "corvid/error.h"
#include "kernels/device.h"

namespace corvid {

/// On what the bench ran, for the head of its tables.
struct BenchMachine {
  std::string processor;
  int cores = 0;
  double load_average = 0;  ///< of the last minute when it was asked; < 0: unknown
  std::string device, driver;
  bool gpu = false;
  int compute_units = 0;
  std::string opencv, compiler;
  int opencv_threads = 0;
};

/// What it is, and OpenCV gets as many threads as it takes by itself. Errors: device.
[[nodiscard]] Expected<BenchMachine> bench_machine(const Device& device);
/// Three lines, for the head of a table.
void print_machine(const BenchMachine& machine, std::ostream& out);

}  // namespace corvid
