#include "replay/player.h"

#include <gtest/gtest.h>

#include <limits>
#include <utility>

namespace corvid {
namespace {

/// Frames at given times, without pictures.
class Times final : public FrameSource {
 public:
  explicit Times(std::vector<std::int64_t> times) : times_(std::move(times)) {
    info_.kind = "times";
    info_.frames = times_.size();
  }
  const SourceInfo& info() const override { return info_; }
  Expected<FramePtr> next(const std::stop_token&) override {
    if (given_ == fail_at) return fail(ErrorCode::io, "broken");
    if (given_ == times_.size()) return FramePtr{};
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(given_));
    frame->time_ns = times_[given_++];
    return frame;
  }
  SourceCounts counts() const override {
    SourceCounts counts;
    counts.delivered = given_;
    counts.skipped = 3;
    return counts;
  }
  Trajectory truth() const override { return {StampedPose{5, Pose{}}}; }
  std::size_t fail_at = std::numeric_limits<std::size_t>::max();

 private:
  std::vector<std::int64_t> times_;
  std::size_t given_ = 0;
  SourceInfo info_;
};

/// Plays all frames; the clock's time at which each came. `work_ns`: what the consumer takes.
std::vector<std::int64_t> play(std::vector<std::int64_t> times, std::optional<double> rate,
                               std::int64_t clock_ns, std::vector<std::int64_t> work_ns = {}) {
  ManualClock clock;
  clock.advance(clock_ns);
  Player player(std::make_unique<Times>(std::move(times)), clock, rate);
  EXPECT_EQ(player.info().paced, rate.has_value());
  std::vector<std::int64_t> came;
  for (auto frame = player.next(); frame && *frame; frame = player.next()) {
    came.push_back(clock.now_ns());
    if (came.size() <= work_ns.size()) clock.advance(work_ns[came.size() - 1]);
  }
  return came;
}
using Ns = std::vector<std::int64_t>;

TEST(Player, KeepsThePaceOfTheCapture) {
  EXPECT_EQ(play({0, 50, 100, 150}, 1.0, 0), (Ns{0, 50, 100, 150}));
  EXPECT_EQ(play({1000, 1050, 1100}, 1.0, 77), (Ns{77, 127, 177}));
}
TEST(Player, ScalesByTheRate) {
  EXPECT_EQ(play({1000, 1050, 1100}, 2.0, 0), (Ns{0, 25, 50}));
  EXPECT_EQ(play({1000, 1050, 1100}, 0.5, 0), (Ns{0, 100, 200}));
}
TEST(Player, WaitsThroughGaps) { EXPECT_EQ(play({0, 50, 950}, 1.0, 0), (Ns{0, 50, 950})); }
TEST(Player, GivesALateConsumerWhatIsOverdueAtOnceAndDropsNothing) {
  EXPECT_EQ(play({0, 50, 100, 150, 200}, 1.0, 0, {130}), (Ns{0, 130, 130, 150, 200}));
}
TEST(Player, GivesAFrameWhoseTimeGoesBackAtOnce) {
  EXPECT_EQ(play({500, 550, 20, 600}, 1.0, 0), (Ns{0, 50, 50, 100}));
}
TEST(Player, WithoutARateNeverWaits) {
  EXPECT_EQ(play({0, 50, 1'000'000'000}, std::nullopt, 9), (Ns{9, 9, 9}));
}
TEST(Player, SurvivesAbsurdTimesAndRates) {
  constexpr std::int64_t kFar = std::numeric_limits<std::int64_t>::max() / 2;
  EXPECT_EQ(play({0, kFar}, 1e-9, 0).size(), 2u);
}
TEST(Player, PassesOnWhatTheSourceSays) {
  ManualClock clock;
  auto source = std::make_unique<Times>(Ns{1, 2});
  source->fail_at = 1;
  Player player(std::move(source), clock, 1.0);
  EXPECT_EQ(player.info().kind, "times");
  EXPECT_EQ(player.info().frames, 2u);
  ASSERT_NE(player.next().value(), nullptr);
  EXPECT_EQ(player.next().error().what, "broken");
  EXPECT_EQ(player.counts().delivered, 1u);
  EXPECT_EQ(player.counts().skipped, 3u);
  EXPECT_EQ(player.truth().size(), 1u);
  EXPECT_FALSE(player.true_surface().has_value());
}
TEST(Player, EndsWhenAskedToStop) {
  ManualClock clock;
  Player player(std::make_unique<Times>(Ns{1, 2}), clock, 1.0);
  std::stop_source stop;
  stop.request_stop();
  EXPECT_EQ(player.next(stop.get_token()).value(), nullptr);
}
TEST(Player, RefusesRatesThatMeanNothing) {
  ManualClock clock;
  for (const double rate : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()})
    EXPECT_THROW(Player(std::make_unique<Times>(Ns{}), clock, rate), std::logic_error);
  EXPECT_THROW(Player(nullptr, clock, 1.0), std::logic_error);
}

}  // namespace
}  // namespace corvid
