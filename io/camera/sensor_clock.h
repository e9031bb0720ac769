#pragma once

#include <cstdint>
#include <string>
#include <utility>

namespace corvid {

/// Brings a camera's time stamps to CLOCK_MONOTONIC. V4L2 says where they are of that clock.
/// libcamera's documentation of SensorTimestamp says CLOCK_BOOTTIME, but its pipelines hand the
/// drivers' stamps through, and those are CLOCK_MONOTONIC. The two differ by the time that the
/// system has slept: a stamp ahead of CLOCK_MONOTONIC must be of CLOCK_BOOTTIME, and so are all
/// that follow. The first stamp that fits neither is said in the log.
class SensorClock {
 public:
  /// @param camera  its name, for the log.
  explicit SensorClock(std::string camera) : camera_(std::move(camera)) {}

  /// @param stamp_ns    as it came with the picture.
  /// @param arrival_ns  when it came, CLOCK_MONOTONIC.
  /// @param slept_ns    CLOCK_BOOTTIME minus CLOCK_MONOTONIC; 0 for stamps that cannot be of the
  /// former.
  /// @return CLOCK_MONOTONIC; the arrival itself for a stamp that fits neither clock, because it is
  ///         more than 10 s old or in the future.
  [[nodiscard]] std::int64_t monotonic_ns(std::int64_t stamp_ns, std::int64_t arrival_ns,
                                          std::int64_t slept_ns);
  /// Whether the last stamp fitted neither clock.
  [[nodiscard]] bool by_arrival() const { return by_arrival_; }

 private:
  std::string camera_;
  bool boottime_ = false, by_arrival_ = false, said_ = false;
};

}  // namespace corvid
