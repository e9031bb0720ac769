#include "io/camera/sensor_clock.h"

#include <gtest/gtest.h>
#include <spdlog/sinks/ostream_sink.h>

#include <cstdint>
#include <limits>
#include <memory>
#include <sstream>
#include <string>

#include "core/log.h"

namespace corvid {
namespace {

constexpr std::int64_t kMs = 1'000'000, kSecond = 1000 * kMs, kNow = 5000 * kSecond;

TEST(SensorClock, MonotonicStampsStayAsTheyAre) {
  for (const std::int64_t slept_ns : {std::int64_t{0}, 5 * kMs, 3600 * kSecond}) {
    SensorClock clock("cam");
    for (int i = 0; i < 5; ++i) {
      const std::int64_t arrival_ns = kNow + i * 33 * kMs, stamp_ns = arrival_ns - (7 + i) * kMs;
      EXPECT_EQ(clock.monotonic_ns(stamp_ns, arrival_ns, slept_ns), stamp_ns);
      EXPECT_FALSE(clock.by_arrival());
    }
  }
}

TEST(SensorClock, BoottimeStampsLoseTheSleep) {
  for (const std::int64_t slept_ns : {20 * kMs, kSecond, 3600 * kSecond}) {
    SensorClock clock("cam");
    // The later ones come so late that they would also fit the other clock.
    for (const std::int64_t latency_ns : {5 * kMs, 30 * kMs, 2 * kSecond}) {
      const std::int64_t stamp_ns = kNow + slept_ns - latency_ns;
      EXPECT_EQ(clock.monotonic_ns(stamp_ns, kNow, slept_ns), kNow - latency_ns);
      EXPECT_FALSE(clock.by_arrival());
    }
  }
}

TEST(SensorClock, SleepDuringTheStreamChangesNothing) {
  SensorClock monotonic("cam"), boottime("cam");
  std::int64_t slept_ns = 60 * kSecond;
  for (int i = 0; i < 2; ++i, slept_ns += 7 * kSecond) {
    const std::int64_t arrival_ns = kNow + i * kSecond, taken_ns = arrival_ns - 10 * kMs;
    EXPECT_EQ(monotonic.monotonic_ns(taken_ns, arrival_ns, slept_ns), taken_ns);
    EXPECT_EQ(boottime.monotonic_ns(taken_ns + slept_ns, arrival_ns, slept_ns), taken_ns);
  }
}

TEST(SensorClock, StampsOfNoClockAreReplacedByTheArrival) {
  SensorClock clock("cam");
  for (const std::int64_t stamp_ns :
       {std::int64_t{0}, std::int64_t{-1}, std::int64_t{1}, kNow - 11 * kSecond, kNow + kSecond,
        std::numeric_limits<std::int64_t>::max(), std::numeric_limits<std::int64_t>::min()}) {
    EXPECT_EQ(clock.monotonic_ns(stamp_ns, kNow, 0), kNow) << stamp_ns;
    EXPECT_TRUE(clock.by_arrival());
  }
  EXPECT_EQ(clock.monotonic_ns(kNow - kMs, kNow, 0), kNow - kMs);
  EXPECT_FALSE(clock.by_arrival());
}

// Stamps and arrivals may be taken on two processors.
TEST(SensorClock, AStampALittleAheadSpoilsNothing) {
  SensorClock clock("cam");
  EXPECT_EQ(clock.monotonic_ns(kNow + 1000, kNow, 0), kNow + 1000);
  EXPECT_FALSE(clock.by_arrival());
  EXPECT_EQ(clock.monotonic_ns(kNow + 30 * kMs, kNow + 37 * kMs, 0), kNow + 30 * kMs);
}

TEST(SensorClock, TheFirstStampOfNoClockIsSaid) {
  std::ostringstream text;
  const auto silent = std::make_shared<spdlog::logger>("corvid");
  set_logger(std::make_shared<spdlog::logger>(
      "corvid", std::make_shared<spdlog::sinks::ostream_sink_st>(text)));
  SensorClock clock("cam");
  (void)clock.monotonic_ns(kNow - kMs, kNow, 0);
  EXPECT_EQ(text.str(), "");
  (void)clock.monotonic_ns(0, kNow, 0);
  const std::string once = text.str();
  EXPECT_NE(once.find("cam: a picture's time stamp is of no known clock"), std::string::npos);
  (void)clock.monotonic_ns(0, kNow, 0);
  set_logger(silent);
  EXPECT_EQ(text.str(), once);
}

}  // namespace
}  // namespace corvid
