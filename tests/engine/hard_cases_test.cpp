// What a camera goes through on a bad day, end to end, without mapping. No case may end in a wrong
// pose that is called good: claimed covariances are compared with the true errors.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <map>
#include <stdexcept>
#include <string>

#include "corvid/engine.h"
#include "scenes/disturbed_flight.h"
#include "scenes/honesty.h"

namespace corvid {
namespace {

using scenes::Disturbance;
using scenes::DisturbedFlight;

constexpr double kRateHz = 10;

FlightOptions flight_options(FlightPath path = FlightPath::survey) {
  FlightOptions options;
  options.width_px = 320;
  options.height_px = 240;
  options.rate_hz = kRateHz;
  options.colour = false;
  options.path = path;
  return options;
}

struct Flown {
  std::size_t handed_out = 0;
  RunResult result;
  std::vector<scenes::ClaimedPose> claims;

  [[nodiscard]] const PoseEvent& at(std::size_t frame) const {
    for (const PoseEvent& e : result.events)
      if (e.frame.value == frame) return e;
    throw std::out_of_range("no event of this frame");
  }
  /// Frames of [first, last) in a state.
  [[nodiscard]] std::size_t count(std::size_t first, std::size_t last, TrackingState state) const {
    return static_cast<std::size_t>(
        std::count_if(result.events.begin(), result.events.end(), [&](const PoseEvent& e) {
          return e.frame.value >= first && e.frame.value < last && e.state == state;
        }));
  }
};

/// Checks what holds in every case: one event per frame that is not refused, states that fit what
/// is published, reasons.
void check_events(const Flown& flown) {
  const SourceCounts& counts = flown.result.counts;
  EXPECT_EQ(flown.result.events.size() + counts.skipped, flown.handed_out);
  EXPECT_EQ(counts.delivered, flown.result.events.size());
  for (std::size_t i = 0; i < flown.result.events.size(); ++i) {
    const PoseEvent& e = flown.result.events[i];
    if (i > 0) {
      EXPECT_GT(e.time_ns, flown.result.events[i - 1].time_ns);
    }
    EXPECT_EQ(e.T_world_camera.has_value(),
              e.state == TrackingState::tracking || e.state == TrackingState::degraded);
    EXPECT_EQ(e.reason.empty(), e.state == TrackingState::tracking) << e.reason;
    EXPECT_TRUE(e.covariance.allFinite());
    if (e.T_world_camera) {
      EXPECT_TRUE(e.T_world_camera->finite());
    }
  }
}

Flown fly(std::size_t frames, const Disturbance& disturbance,
          const FlightOptions& flight = flight_options()) {
  DisturbedFlight source(flight, frames, disturbance);
  Options options;
  options.threads = 1;
  options.frontend.max_tracks = 400;
  options.mapping.enabled = false;
  auto engine = Engine::create(options);
  if (!engine) throw std::runtime_error(engine.error().to_string());
  auto result = (*engine)->run(source);
  if (!result) throw std::runtime_error(result.error().to_string());
  Flown flown;
  flown.handed_out = source.frames();
  flown.result = std::move(*result);
  flown.claims = scenes::compare_claims(flown.result.events, source.truth(),
                                        scenes::segment_origins(*flown.result.map));
  check_events(flown);
  return flown;
}

/// No pose is far from what it claims, and those that are called good less so.
void expect_honest(const Flown& flown, double worst_sigmas = 6) {
  std::vector<scenes::ClaimedPose> good;
  std::copy_if(flown.claims.begin(), flown.claims.end(), std::back_inserter(good),
               [](const auto& c) { return c.state == TrackingState::tracking; });
  const scenes::Honesty of_good = scenes::summarise(good);
  const scenes::Honesty of_all = scenes::summarise(flown.claims);
  std::printf(
      "  tracking: %zu poses, %.1f %% within 99.9 %%, median squared %.2f (5.35), worst %.2f "
      "sigmas in event %zu; all: %zu poses, %.1f %%, worst %.2f in event %zu; %zu keyframes\n",
      of_good.poses, 100 * of_good.within, of_good.median_squared, of_good.worst,
      of_good.worst_event, of_all.poses, 100 * of_all.within, of_all.worst, of_all.worst_event,
      flown.result.map->keyframes.size());
  EXPECT_GE(of_good.within, 0.95);
  EXPECT_LE(of_good.worst, worst_sigmas);
  EXPECT_GE(of_all.within, 0.95);
  EXPECT_LE(of_all.worst, worst_sigmas);
}

std::size_t first_pose(const Flown& flown) {
  for (const PoseEvent& e : flown.result.events)
    if (e.T_world_camera) return e.frame.value;
  return flown.handed_out;
}

void expect_never_starts(const Flown& flown) {
  EXPECT_EQ(flown.count(0, flown.handed_out, TrackingState::starting), flown.handed_out);
  EXPECT_TRUE(flown.result.trajectory.empty());
  EXPECT_TRUE(flown.result.map->keyframes.empty());
  EXPECT_TRUE(flown.result.map->landmarks.empty());
}

TEST(HardCases, PlainFlights) {
  for (const FlightPath path : {FlightPath::survey, FlightPath::orbit, FlightPath::nadir}) {
    const Flown flown = fly(80, {}, flight_options(path));
    EXPECT_EQ(flown.count(first_pose(flown), 80, TrackingState::tracking), 80 - first_pose(flown));
    EXPECT_EQ(flown.result.events.back().segment, 0);
    expect_honest(flown);
  }
}

TEST(HardCases, PureRotationNeverStartsAndSaysSo) {
  const Flown flown = fly(50, {}, flight_options(FlightPath::rotation));
  expect_never_starts(flown);
  EXPECT_EQ(flown.result.events.back().reason, "the camera stands still or only turns");
}

TEST(HardCases, StandingStillNeverStarts) {
  const Flown flown = fly(30, {}, flight_options(FlightPath::hover));
  expect_never_starts(flown);
  EXPECT_FALSE(flown.result.events.back().reason.empty());
}

TEST(HardCases, StandingStillInFlightAddsNoKeyframes) {
  Disturbance hover;
  hover.pose = [](const SyntheticFlight& flight, std::size_t i) {
    return flight.true_pose(i < 40 ? i : i < 70 ? 40 : i - 30);
  };
  const Flown flown = fly(90, hover);
  EXPECT_EQ(flown.count(40, 90, TrackingState::tracking), 50U);
  std::size_t keyframes = 0;
  for (std::size_t i = 43; i < 70; ++i) keyframes += flown.at(i).keyframe ? 1U : 0U;
  EXPECT_LE(keyframes, 1U);
  expect_honest(flown);
}

TEST(HardCases, TurningAwayInFlightIsDegradedThenLost) {
  Disturbance turn;
  turn.pose = [](const SyntheticFlight& flight, std::size_t i) {
    Vector6d turned = Vector6d::Zero();
    turned[4] = 0.035 * static_cast<double>(i < 40 ? 0 : std::min<std::size_t>(i, 80) - 40);
    return flight.true_pose(i < 40 ? i : i < 80 ? 40 : i - 40) * Pose::exp(turned);
  };
  const Flown flown = fly(110, turn);
  EXPECT_GT(flown.count(60, 80, TrackingState::degraded), 0U);
  EXPECT_TRUE(flown.result.events.back().T_world_camera);
  expect_honest(flown);
}

/// Lost soon after the lens is covered; poses again soon after it is free.
void expect_lost_and_found(const Flown& flown, std::size_t from, std::size_t to,
                           std::size_t frames) {
  EXPECT_TRUE(flown.at(from - 1).T_world_camera);
  for (std::size_t i = from + 2; i < to; ++i) EXPECT_FALSE(flown.at(i).T_world_camera) << i;
  std::size_t found = to;
  while (found < frames && !flown.at(found).T_world_camera) ++found;
  EXPECT_LE(found - to, 30U) << "lost for good";
  EXPECT_EQ(flown.count(found, frames, TrackingState::tracking) +
                flown.count(found, frames, TrackingState::degraded),
            frames - found);
}

TEST(HardCases, ACoveredLensIsLostAndFound) {
  for (const double seconds : {1.0, 5.0, 30.0}) {
    Disturbance cover;
    const auto covered = static_cast<std::size_t>(seconds * kRateHz);
    cover.covered = {30, 30 + covered};
    const std::size_t frames = 70 + covered;
    const Flown flown = fly(frames, cover);
    expect_lost_and_found(flown, 30, 30 + covered, frames);
    expect_honest(flown);
  }
}

// It hangs where it was while it is away: the map goes on, however long that took.
TEST(HardCases, AnUnpluggedCameraIsLostAtOnceAndGoesOnInItsMap) {
  for (const std::size_t blind : {5U, 300U}) {
    Disturbance away;
    away.away = {30, 30 + blind};
    away.pose = [blind](const SyntheticFlight& flight, std::size_t i) {
      return flight.true_pose(i < 30 ? i : i < 30 + blind ? 29 : i - blind);
    };
    const std::size_t frames = 70 + blind;
    const Flown flown = fly(frames, away);
    EXPECT_EQ(flown.at(30).state, TrackingState::lost);
    EXPECT_EQ(flown.at(30).reason, "the camera is unplugged");
    expect_lost_and_found(flown, 30, 30 + blind, frames);
    EXPECT_EQ(flown.count(30 + blind, frames, TrackingState::lost), 0U);
    EXPECT_EQ(flown.result.events.back().segment, 0);
    EXPECT_EQ(flown.result.events.back().resets, 0U);
    EXPECT_EQ(flown.result.trajectory.size(), frames - blind);
    expect_honest(flown);
  }
}

TEST(HardCases, ACameraThatIsUnpluggedBeforeThereIsAMapIsNotLost) {
  Disturbance away;
  away.away = {0, 20};
  const Flown flown = fly(60, away);
  EXPECT_EQ(flown.count(0, 20, TrackingState::starting), 20U);
  EXPECT_TRUE(flown.result.events.back().T_world_camera);
  expect_honest(flown);
}

TEST(HardCases, AKidnappedCameraDoesNotGoOnInTheOldMapAsIfNothingWere) {
  for (const std::size_t far : {40U, 300U}) {
    Disturbance kidnap;
    kidnap.kidnapped_at = 40;
    kidnap.kidnapped_by = far;
    const Flown flown = fly(80, kidnap);
    EXPECT_FALSE(flown.at(40).T_world_camera);
    expect_lost_and_found(flown, 40, 41, 80);
    expect_honest(flown);
  }
}

TEST(HardCases, AnExposureJumpIsSurvived) {
  for (const double factor : {1.6, 0.4}) {
    Disturbance jump;
    jump.brighter_from = 35;
    jump.brighter = factor;
    const Flown flown = fly(70, jump);
    EXPECT_EQ(
        flown.count(35, 70, TrackingState::tracking) + flown.count(35, 70, TrackingState::degraded),
        35U);
    EXPECT_EQ(flown.result.events.back().segment, 0);
    expect_honest(flown);
  }
}

TEST(HardCases, ThirtyPercentOfTheFramesMissing) {
  Disturbance gaps;
  gaps.missing = 0.3;
  const Flown flown = fly(100, gaps);
  EXPECT_LT(flown.handed_out, 80U);
  EXPECT_EQ(flown.result.events.back().segment, 0);
  EXPECT_EQ(flown.count(first_pose(flown), 100, TrackingState::lost), 0U);
  expect_honest(flown);
}

TEST(HardCases, FramesThatComeTwiceOrLateAreRefusedAndCounted) {
  Disturbance twice, late;
  twice.twice_every = 5;
  late.swapped_every = 9;
  const Flown doubled = fly(60, twice), swapped = fly(60, late);
  EXPECT_EQ(doubled.handed_out, 72U);
  EXPECT_EQ(doubled.result.counts.skipped, 12U);
  ASSERT_FALSE(doubled.result.counts.messages.empty());
  EXPECT_EQ(doubled.result.counts.messages.front(),
            "frame 4: its time is that of the frame before it");
  EXPECT_EQ(swapped.result.counts.skipped, 6U);
  ASSERT_FALSE(swapped.result.counts.messages.empty());
  EXPECT_EQ(swapped.result.counts.messages.front(),
            "frame 8: its time is before that of the frame before it");
  for (const Flown* flown : {&doubled, &swapped}) {
    EXPECT_EQ(flown->count(first_pose(*flown), 60, TrackingState::lost), 0U);
    expect_honest(*flown);
  }
}

TEST(HardCases, AStalePictureUnderANewTimeIsDegraded) {
  Disturbance stale;
  stale.stale_every = 7;
  const Flown flown = fly(80, stale);
  EXPECT_EQ(flown.at(34).state, TrackingState::degraded);
  EXPECT_NE(flown.at(34).reason.find("same as the one before"), std::string::npos);
  EXPECT_EQ(flown.at(35).state, TrackingState::tracking);
  expect_honest(flown);
}

TEST(HardCases, AFrozenPictureIsForetoldForAMomentAndThenLost) {
  Disturbance frozen;
  frozen.frozen = {40, 70};
  const Flown flown = fly(100, frozen);
  EXPECT_EQ(flown.at(40).state, TrackingState::degraded);
  EXPECT_EQ(flown.at(69).state, TrackingState::lost);
  EXPECT_NE(flown.at(69).reason.find("the same for too long"), std::string::npos);
  EXPECT_FALSE(flown.at(69).T_world_camera.has_value());
  // Each foretold pose claims more than the one before.
  double claimed = 0;
  std::size_t foretold = 0;
  for (std::size_t i = 40; flown.at(i).state == TrackingState::degraded; ++i, ++foretold) {
    const double trace = flown.at(i).covariance.topLeftCorner<3, 3>().trace();
    EXPECT_GT(trace, claimed);
    claimed = trace;
  }
  EXPECT_GT(foretold, 2U);
  expect_honest(flown);
}

TEST(HardCases, ACalibrationThatIsSlightlyWrongIsCoveredByWhatIsClaimed) {
  Disturbance focal;
  focal.focal = 1.01;
  expect_honest(fly(100, focal));
}

TEST(HardCases, ACalibrationThatIsWrongByTenPercentIsFoundOut) {
  for (const double factor : {0.9, 1.1}) {
    Disturbance focal;
    focal.focal = factor;
    const Flown flown = fly(80, focal);
    EXPECT_EQ(flown.count(40, 80, TrackingState::degraded), 40U);
    EXPECT_NE(flown.result.events.back().reason.find("the calibration does not fit"),
              std::string::npos);
    EXPECT_NE(flown.result.events.back().reason.find(factor < 1 ? "longer" : "shorter"),
              std::string::npos);
    expect_honest(flown);
  }
}

TEST(HardCases, AThirdOfTheImageMoves) {
  for (const std::size_t from : {0U, 40U}) {
    Disturbance patch;
    patch.patch_from = from;
    expect_honest(fly(80, patch));
  }
}

}  // namespace
}  // namespace corvid
