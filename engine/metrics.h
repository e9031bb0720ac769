#pragma once

#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "core/stopwatch.h"
#include "corvid/run_result.h"

namespace corvid {

/// Durations of the stages and their parts over a run. Thread-safe.
class Metrics {
 public:
  void add(const std::string& name, double ms);
  void add(const Timings& timings);
  /// One row for each name, sorted, so that a stage stands before its parts.
  [[nodiscard]] std::vector<StageMetrics> summary() const;

 private:
  mutable std::mutex mutex_;
  std::map<std::string, std::vector<float>> samples_ms_;
};

/// Highest resident memory of this process so far.
[[nodiscard]] std::uint64_t peak_memory_bytes();

}  // namespace corvid
