#pragma once

#include <cstdint>

namespace corvid {

/// Brings libcamera's SensorTimestamp to CLOCK_MONOTONIC. Its documentation says CLOCK_BOOTTIME,
/// but its pipelines hand the drivers' stamps through, and those are CLOCK_MONOTONIC. The two
/// differ by the time that the system has slept: a stamp ahead of CLOCK_MONOTONIC must be of
/// CLOCK_BOOTTIME, and so are all that follow.
class SensorClock {
 public:
  /// @param stamp_ns    as it came with the picture.
  /// @param arrival_ns  when it came, CLOCK_MONOTONIC.
  /// @param slept_ns    CLOCK_BOOTTIME minus CLOCK_MONOTONIC.
  /// @return CLOCK_MONOTONIC; the arrival itself for a stamp that fits neither clock, because it is
  ///         more than 10 s old or in the future.
  [[nodiscard]] std::int64_t monotonic_ns(std::int64_t stamp_ns, std::int64_t arrival_ns,
                                          std::int64_t slept_ns);
  /// Whether the last stamp fitted neither clock.
  [[nodiscard]] bool by_arrival() const { return by_arrival_; }

 private:
  bool boottime_ = false, by_arrival_ = false;
};

}  // namespace corvid
