#include "io/camera/sensor_clock.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <limits>

namespace corvid {
namespace {

constexpr std::int64_t kMs = 1'000'000, kSecond = 1000 * kMs, kNow = 5000 * kSecond;

TEST(SensorClock, MonotonicStampsStayAsTheyAre) {
  for (const std::int64_t slept_ns : {std::int64_t{0}, 5 * kMs, 3600 * kSecond}) {
    SensorClock clock;
    for (int i = 0; i < 5; ++i) {
      const std::int64_t arrival_ns = kNow + i * 33 * kMs, stamp_ns = arrival_ns - (7 + i) * kMs;
      EXPECT_EQ(clock.monotonic_ns(stamp_ns, arrival_ns, slept_ns), stamp_ns);
      EXPECT_FALSE(clock.by_arrival());
    }
  }
}

TEST(SensorClock, BoottimeStampsLoseTheSleep) {
  for (const std::int64_t slept_ns : {20 * kMs, kSecond, 3600 * kSecond}) {
    SensorClock clock;
    // The later ones come so late that they would also fit the other clock.
    for (const std::int64_t latency_ns : {5 * kMs, 30 * kMs, 2 * kSecond}) {
      const std::int64_t stamp_ns = kNow + slept_ns - latency_ns;
      EXPECT_EQ(clock.monotonic_ns(stamp_ns, kNow, slept_ns), kNow - latency_ns);
      EXPECT_FALSE(clock.by_arrival());
    }
  }
}

TEST(SensorClock, SleepDuringTheStreamChangesNothing) {
  SensorClock monotonic, boottime;
  std::int64_t slept_ns = 60 * kSecond;
  for (int i = 0; i < 2; ++i, slept_ns += 7 * kSecond) {
    const std::int64_t arrival_ns = kNow + i * kSecond, taken_ns = arrival_ns - 10 * kMs;
    EXPECT_EQ(monotonic.monotonic_ns(taken_ns, arrival_ns, slept_ns), taken_ns);
    EXPECT_EQ(boottime.monotonic_ns(taken_ns + slept_ns, arrival_ns, slept_ns), taken_ns);
  }
}

TEST(SensorClock, StampsOfNoClockAreReplacedByTheArrival) {
  SensorClock clock;
  for (const std::int64_t stamp_ns :
       {std::int64_t{0}, std::int64_t{-1}, std::int64_t{1}, kNow - 11 * kSecond, kNow + kSecond,
        std::numeric_limits<std::int64_t>::max(), std::numeric_limits<std::int64_t>::min()}) {
    EXPECT_EQ(clock.monotonic_ns(stamp_ns, kNow, 0), kNow) << stamp_ns;
    EXPECT_TRUE(clock.by_arrival());
  }
  EXPECT_EQ(clock.monotonic_ns(kNow - kMs, kNow, 0), kNow - kMs);
  EXPECT_FALSE(clock.by_arrival());
}

}  // namespace
}  // namespace corvid
