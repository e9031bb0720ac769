#include "engine/metrics.h"

#include <sys/resource.h>

#include <algorithm>
#include <cmath>

namespace corvid {
namespace {

double quantile(const std::vector<float>& sorted, double q) {
  const auto rank = static_cast<std::size_t>(std::ceil(q * static_cast<double>(sorted.size())));
  return sorted[std::clamp<std::size_t>(rank, 1, sorted.size()) - 1];
}

}  // namespace

void Metrics::add(const std::string& name, double ms) {
  const std::lock_guard lock(mutex_);
  samples_ms_[name].push_back(static_cast<float>(ms));
}

void Metrics::add(const Timings& timings) {
  for (const auto& [name, ms] : timings) add(name, ms);
}

std::vector<StageMetrics> Metrics::summary() const {
  const std::lock_guard lock(mutex_);
  std::vector<StageMetrics> rows;
  for (const auto& [name, samples] : samples_ms_) {
    std::vector<float> sorted = samples;
    std::sort(sorted.begin(), sorted.end());
    double total = 0;
    for (const float ms : sorted) total += ms;
    rows.push_back({name, sorted.size(), quantile(sorted, 0.5), quantile(sorted, 0.95),
                    quantile(sorted, 0.99), total / 1000});
  }
  return rows;
}

std::uint64_t peak_memory_bytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;
}

}  // namespace corvid
