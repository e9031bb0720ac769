#include "core/clock.h"

#include <gtest/gtest.h>

#include <thread>

namespace corvid {
namespace {

TEST(SteadyClock, NeverGoesBackAndWakesNoSoonerThanAsked) {
  SteadyClock clock;
  const std::int64_t start = clock.now_ns();
  const std::int64_t wake = start + 5'000'000;
  clock.sleep_until(wake, {});
  EXPECT_GE(clock.now_ns(), wake);
  clock.sleep_until(start, {});  // the past: returns at once
  EXPECT_GE(clock.now_ns(), wake);
}

TEST(SteadyClock, WakesWhenAskedToStop) {
  SteadyClock clock;
  std::stop_source source;
  const std::int64_t far = clock.now_ns() + 3600LL * 1'000'000'000;
  std::jthread stopper([&source] { source.request_stop(); });
  clock.sleep_until(far, source.get_token());  // returns, or the test never ends
  EXPECT_LT(clock.now_ns(), far);
  clock.sleep_until(far, source.get_token());
  EXPECT_LT(clock.now_ns(), far);
}

TEST(ManualClock, MovesOnlyWhenToldTo) {
  ManualClock clock;
  EXPECT_EQ(clock.now_ns(), 0);
  clock.advance(5);
  EXPECT_EQ(clock.now_ns(), 5);
  clock.sleep_until(100, {});
  EXPECT_EQ(clock.now_ns(), 100);
  clock.sleep_until(50, {});
  EXPECT_EQ(clock.now_ns(), 100);
}

}  // namespace
}  // namespace corvid
