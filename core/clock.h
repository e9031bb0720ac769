#pragma once

#include <chrono>
#include <cstdint>
#include <stop_token>

namespace corvid {

/// a - b [s], without overflow, for times of any clock.
[[nodiscard]] inline double difference_s(std::int64_t a_ns, std::int64_t b_ns) {
  return 1e-9 * (static_cast<double>(a_ns) - static_cast<double>(b_ns));
}

/// Where time comes from; injected so that tests need not wait.
class Clock {
 public:
  virtual ~Clock() = default;
  [[nodiscard]] virtual std::int64_t now_ns() = 0;
  /// Returns at `time_ns`, or earlier when asked to stop.
  virtual void sleep_until(std::int64_t time_ns, const std::stop_token& stop) = 0;
};

/// CLOCK_MONOTONIC.
class SteadyClock final : public Clock {
 public:
  [[nodiscard]] std::int64_t now_ns() override;
  void sleep_until(std::int64_t time_ns, const std::stop_token& stop) override;
};

/// Time that moves only when somebody sleeps or calls advance(). Not thread-safe.
class ManualClock final : public Clock {
 public:
  [[nodiscard]] std::int64_t now_ns() override { return now_ns_; }
  void sleep_until(std::int64_t time_ns, const std::stop_token&) override {
    if (time_ns > now_ns_) now_ns_ = time_ns;
  }
  void advance(std::int64_t ns) { now_ns_ += ns; }

 private:
  std::int64_t now_ns_ = 0;
};

}  // namespace corvid
