#include "bench/timing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <string>
#include <thread>

namespace corvid {
namespace {

TEST(Median, IsTheMiddleOrTheMeanOfTheTwo) {
  EXPECT_EQ(median({}), 0);
  EXPECT_EQ(median({7}), 7);
  EXPECT_EQ(median({9, 1, 5}), 5);
  EXPECT_EQ(median({9, 1, 5, 4}), 4.5);
}

TEST(TimeInTurn, RunsEachInTurnAfterOneRunThatDoesNotCount) {
  std::string order;
  bool first = true;
  const TimedWork works[] = {{[&] {
                                order += 'a';
                                // Sleep never ends early: only a run that counts by mistake is
                                // faster.
                                if (!first)
                                  std::this_thread::sleep_for(std::chrono::milliseconds(2));
                                first = false;
                              },
                              [&] { order += '.'; }},
                             {[&] { order += 'b'; }}};
  const auto timings = time_in_turn(works, 3, {});
  EXPECT_EQ(order, ".ab.ab.ab.ab");
  ASSERT_EQ(timings.size(), 2U);
  EXPECT_GE(timings[0].fastest_ms, 2) << "the first run was not to be timed";
  EXPECT_GE(timings[0].median_ms, timings[0].fastest_ms);
}

TEST(TimeInTurn, GivesNothingWhenItWasStopped) {
  std::stop_source stop;
  int runs = 0;
  const TimedWork work{[&] {
    if (++runs == 3) stop.request_stop();
  }};
  EXPECT_TRUE(time_in_turn({&work, 1}, 100, stop.get_token()).empty());
  EXPECT_EQ(runs, 3);
}

}  // namespace
}  // namespace corvid
