// What a camera goes through on a bad day, end to end without mapping. No case may end in a wrong
// pose that is called good: claimed covariances are compared with the true errors.
#include <gtest/gtest.h>

#include <cstdio>
#include <string>

#include "corvid/engine.h"
#include "scenes/disturbed_flight.h"
#include "scenes/honesty.h"

namespace corvid {
namespace {

using scenes::DisturbedFlight;
using scenes::Disturbance;
using scenes::Honesty;

FlightOptions flight_options(FlightPath path = FlightPath::survey) {
  FlightOptions options;
  options.width_px = 320;
  options.height_px = 240;
  options.rate_hz = 10;
  options.colour = false;
  options.path = path;
  return options;
}

struct Flown {
  std::size_t handed_out = 0;
  RunResult result;
  std::vector<scenes::ClaimedPose> claims;
  Honesty honesty;

  [[nodiscard]] const PoseEvent& at(std::size_t frame) const {
    for (const PoseEvent& e : result.events)
      if (e.frame.value == frame) return e;
    throw std::out_of_range("no event of this frame");
  }
};

Flown fly(std::size_t frames, const Disturbance& disturbance,
          const FlightOptions& flight = flight_options()) {
  DisturbedFlight source(flight, frames, disturbance);
  Options options;
  options.threads = 1;
  options.frontend.max_tracks = 400;
  options.mapping.enabled = false;
  auto engine = Engine::create(options);
  EXPECT_TRUE(engine);
  auto result = (*engine)->run(source);
  EXPECT_TRUE(result);
  Flown flown;
  flown.handed_out = source.frames();
  flown.result = std::move(*result);
  flown.claims = scenes::compare_claims(flown.result.events, source.truth(),
                                        scenes::segment_origins(*flown.result.map));
  flown.honesty = scenes::summarise(flown.claims);
  const Honesty& h = flown.honesty;
  std::printf("  %zu poses, %zu keyframes, %.1f %% within, median squared %.2f, worst %.2f sigmas (event %zu)\n",
              h.poses, flown.result.map->keyframes.size(), 100 * h.within, h.median_squared, h.worst, h.worst_event);
  if (std::getenv("CORVID_TALK")) {
    std::map<std::size_t, scenes::ClaimedPose> by;
    for (auto& c : flown.claims) by[c.event] = c;
    for (std::size_t i = 0; i < flown.result.events.size(); ++i) {
      const auto& e = flown.result.events[i];
      std::printf("   %u seg %d %s%s tracks %d inl %d mse %.4f", e.frame.value, e.segment,
                  std::string(to_string(e.state)).c_str(), e.keyframe ? " K" : "", e.tracks,
                  e.inliers, e.mse_px2);
      if (by.contains(i)) {
        auto& c = by[i];
        std::printf(" sig %.2f (p %.2f o %.2f) err %.5f claim %.5f rot %.5f", c.sigmas, c.position_sigmas, c.orientation_sigmas, c.position_error,
                    c.position_claimed, c.orientation_error_rad);
      }
      std::printf(" %s\n", e.reason.c_str());
    }
  }
  return flown;
}

TEST(HardCases, APlainFlight) { fly(120, {}); }
TEST(HardCases, PlainOrbit) { fly(120, {}, flight_options(FlightPath::orbit)); }
TEST(HardCases, PlainNadir) { fly(120, {}, flight_options(FlightPath::nadir)); }
TEST(HardCases, PlainFacade) { fly(120, {}, flight_options(FlightPath::facade)); }
TEST(HardCases, PureRotation) { fly(80, {}, flight_options(FlightPath::rotation)); }
TEST(HardCases, StandingStill) { fly(60, {}, flight_options(FlightPath::hover)); }
TEST(HardCases, StopsInFlight) {
  Disturbance d;
  d.pose = [](const SyntheticFlight& f, std::size_t i) { return f.true_pose(i < 50 ? i : i < 90 ? 50 : i - 40); };
  fly(120, d);
}
TEST(HardCases, TurnsInFlight) {
  Disturbance d;
  d.pose = [](const SyntheticFlight& f, std::size_t i) { 
    if (i < 50) return f.true_pose(i);
    const double t = 0.1 * static_cast<double>(std::min<std::size_t>(i, 90) - 50);
    Vector6d turn = Vector6d::Zero();
    turn[4] = 0.35 * t;
    return f.true_pose(i < 90 ? 50 : i - 40) * Pose::exp(turn); };
  fly(120, d);
}
TEST(HardCases, Covered1) { Disturbance d; d.covered = {50, 60}; fly(100, d); }
TEST(HardCases, Covered5) { Disturbance d; d.covered = {50, 100}; fly(150, d); }
TEST(HardCases, Covered30) { Disturbance d; d.covered = {50, 350}; fly(400, d); }
TEST(HardCases, Kidnapped) { Disturbance d; d.kidnapped_at = 50; d.kidnapped_by = 300; fly(110, d); }
TEST(HardCases, Kidnapped2) { Disturbance d; d.kidnapped_at = 50; d.kidnapped_by = 40; fly(110, d); }
TEST(HardCases, Exposure) { Disturbance d; d.brighter_from = 50; d.brighter = 1.6; fly(100, d); }
TEST(HardCases, ExposureDown) { Disturbance d; d.brighter_from = 50; d.brighter = 0.4; fly(100, d); }
TEST(HardCases, Missing) { Disturbance d; d.missing = 0.3; fly(120, d); }
TEST(HardCases, Twice) { Disturbance d; d.twice_every = 5; fly(100, d); }
TEST(HardCases, Stale) { Disturbance d; d.stale_every = 7; fly(100, d); }
TEST(HardCases, Swapped) { Disturbance d; d.swapped_every = 9; fly(100, d); }
TEST(HardCases, Focal1) { Disturbance d; d.focal = 1.01; fly(120, d); }
TEST(HardCases, Focal10) { Disturbance d; d.focal = 1.1; fly(120, d); }
TEST(HardCases, Focal90) { Disturbance d; d.focal = 0.9; fly(120, d); }
TEST(HardCases, Patch) { Disturbance d; d.patch_from = 0; fly(80, d); }
TEST(HardCases, PatchLater) { Disturbance d; d.patch_from = 40; fly(100, d); }

}  // namespace
}  // namespace corvid
