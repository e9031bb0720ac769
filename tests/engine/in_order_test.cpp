#include "engine/in_order.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <vector>

namespace corvid {
namespace {

using ::testing::ElementsAre;

/// Frames with the given times [s] and running numbers; then the end, or an error.
class Times final : public FrameSource {
 public:
  explicit Times(std::vector<double> times_s, bool breaks = false) : breaks_(breaks) {
    for (const double t : times_s) times_ns.push_back(static_cast<std::int64_t>(1e9 * t));
  }
  const SourceInfo& info() const override { return info_; }
  Expected<FramePtr> next(const std::stop_token&) override {
    if (given_ >= times_ns.size() && breaks_) return fail(ErrorCode::io, "unplugged");
    if (given_ >= times_ns.size()) return FramePtr();
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(given_));
    frame->time_ns = times_ns[given_++];
    return FramePtr(std::move(frame));
  }
  SourceCounts counts() const override { return {given_, 0, 0, {}}; }
  std::vector<std::int64_t> times_ns;

 private:
  SourceInfo info_;
  bool breaks_;
  std::size_t given_ = 0;
};

struct Passed {
  std::vector<std::uint32_t> frames;
  SourceCounts counts;
  std::optional<Error> error;
};

Passed pass(Times source) {
  InOrder in_order(source);
  Passed passed;
  std::int64_t newest_ns = std::numeric_limits<std::int64_t>::min();
  while (true) {
    const auto frame = in_order.next({});
    if (!frame) passed.error = frame.error();
    if (!frame || !*frame) break;
    EXPECT_TRUE(passed.frames.empty() || (*frame)->time_ns > newest_ns);
    newest_ns = (*frame)->time_ns;
    passed.frames.push_back((*frame)->id.value);
  }
  passed.counts = in_order.counts();
  return passed;
}

TEST(InOrder, RefusesWhatComesTwiceOrLate) {
  const Passed passed = pass(Times({0, 0.1, 0.1, 0.3, 0.2, 0.4}));
  EXPECT_FALSE(passed.error);
  EXPECT_THAT(passed.frames, ElementsAre(0, 1, 3, 5));
  EXPECT_EQ(passed.counts.skipped, 2U);
  EXPECT_EQ(passed.counts.delivered, 4U);
  EXPECT_THAT(passed.counts.messages,
              ElementsAre("frame 2: its time is that of the frame before it",
                          "frame 4: its time is before that of the frame before it"));
}

TEST(InOrder, OneTimeFarAheadCostsOneFrame) {
  std::vector<double> times;
  for (int i = 0; i < 40; ++i) times.push_back(i == 7 ? 86'400 : 0.05 * i);
  const Passed passed = pass(Times(times));
  EXPECT_FALSE(passed.error);
  EXPECT_EQ(passed.frames.size(), 39U);
  EXPECT_THAT(passed.counts.messages,
              ElementsAre("frame 7: its time is far ahead of that of the frame after it"));
}

TEST(InOrder, APauseIsNoFault) {
  EXPECT_THAT(pass(Times({0, 0.1, 60, 60.1, 120, 180})).frames, ElementsAre(0, 1, 2, 3, 4, 5));
  // A late frame and one that comes twice after the pause do not undo it.
  EXPECT_THAT(pass(Times({0, 0.1, 60, 0.05, 60, 60.1})).frames, ElementsAre(0, 1, 2, 5));
}

TEST(InOrder, WhatWaitsIsGivenBeforeTheEndAndBeforeAnError) {
  EXPECT_THAT(pass(Times({0, 60})).frames, ElementsAre(0, 1));
  const Passed broken = pass(Times({0, 60}, true));
  EXPECT_THAT(broken.frames, ElementsAre(0, 1));
  ASSERT_TRUE(broken.error);
  EXPECT_EQ(broken.error->what, "unplugged");
}

TEST(InOrder, AClockThatGoesBackForGoodEndsTheRunWithWords) {
  std::vector<double> times{1000, 1000.05, 1000.1};
  for (int i = 0; i < 40; ++i) times.push_back(0.05 * i);
  const Passed passed = pass(Times(times));
  EXPECT_THAT(passed.frames, ElementsAre(0, 1, 2));
  ASSERT_TRUE(passed.error);
  EXPECT_EQ(passed.error->code, ErrorCode::corrupt);
  EXPECT_EQ(passed.error->what, "the clock of the frames went back by 999.650 s for good");
  EXPECT_EQ(passed.error->where, "frame 12");
  EXPECT_FALSE(passed.error->hint.empty());
  EXPECT_EQ(passed.counts.skipped, 10U);
}

TEST(InOrder, LateFramesThatComeToAnEndDoNotEndTheRun) {
  std::vector<double> times{1000};
  for (int i = 0; i < 9; ++i) times.push_back(0.05 * i);  // of an old buffer
  times.push_back(1000.1);
  for (int i = 0; i < 30; ++i) times.push_back(999.9 + 0.001 * i);  // a burst that was held up
  times.push_back(1000.2);
  for (int i = 0; i < 30; ++i) times.push_back(5);  // one frame over and over
  times.push_back(1000.3);
  const Passed passed = pass(Times(times));
  EXPECT_FALSE(passed.error);
  EXPECT_THAT(passed.frames, ElementsAre(0, 10, 41, 72));
}

TEST(InOrder, TheEndsOfAllClocks) {
  Times source({});
  constexpr auto kLeast = std::numeric_limits<std::int64_t>::min();
  constexpr auto kMost = std::numeric_limits<std::int64_t>::max();
  source.times_ns = {kLeast, kMost, kMost, kLeast, 0};
  const Passed passed = pass(source);
  EXPECT_FALSE(passed.error);
  EXPECT_THAT(passed.frames, ElementsAre(0, 4));
}

}  // namespace
}  // namespace corvid
