#include "bench/timing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stop_token>
#include <string>

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
  double now_ms = 100;
  const double lasts_ms[] = {1, 7, 3, 20};  // the first does not count
  int run = 0;
  const TimedWork works[] = {{[&] {
                                order += 'a';
                                now_ms += lasts_ms[run++];
                              },
                              [&] {
                                order += '.';
                                now_ms += 1000;
                              }},
                             {[&] {
                               order += 'b';
                               now_ms += 2;
                             }}};
  const auto timings = time_in_turn(works, 3, {}, [&] { return now_ms; });
  EXPECT_EQ(order, ".ab.ab.ab.ab");
  ASSERT_EQ(timings.size(), 2U);
  EXPECT_EQ(timings[0].fastest_ms, 3);
  EXPECT_EQ(timings[0].median_ms, 7);
  EXPECT_EQ(timings[1].fastest_ms, 2);
  EXPECT_EQ(timings[1].median_ms, 2);
}

TEST(TimeInTurn, ItsOwnClockGoesForward) {
  const double before_ms = wall_ms();
  EXPECT_GE(wall_ms(), before_ms);
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
