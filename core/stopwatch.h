#pragma once

#include <chrono>
#include <string>
#include <utility>
#include <vector>

namespace corvid {

/// Named durations [ms] of the parts of one piece of work, in order.
using Timings = std::vector<std::pair<std::string, double>>;

/// Measures parts of a piece of work one after the other.
class Stopwatch {
 public:
  /// Milliseconds since construction or the last lap.
  double lap_ms() {
    const auto now = std::chrono::steady_clock::now();
    const double ms = std::chrono::duration<double, std::milli>(now - last_).count();
    last_ = now;
    return ms;
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

}  // namespace corvid
