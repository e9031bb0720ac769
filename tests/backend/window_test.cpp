#include "backend/window.h"

#include <gtest/gtest.h>

#include <iostream>
#include <random>

#include "backend/simulator.h"

namespace corvid {
namespace {

/// Keyframes of a simulated flight, each a few centimetres and tenths of a degree off.
struct RoughMap {
  explicit RoughMap(const test::Flight& simulated) : flight(simulated) {
    map.camera = *flight.frames.front().frame->camera;
    std::mt19937 random(11);
    std::normal_distribution<double> noise;
    for (std::size_t i = 0; i < flight.frames.size(); i += 5) {
      const FrameTracks& tracks = flight.frames[i];
      Vector6d off;
      for (int k = 0; k < 6; ++k) off[k] = (k < 3 ? 0.03 : 0.003) * noise(random);
      const int k =
          map.add_keyframe(tracks.frame, 0, flight.truth[i] * Pose::exp(off), tracks.observations);
      map.triangulate_tracks(k, 0.01, 50);
    }
  }
  [[nodiscard]] double error() const {
    Trajectory trajectory;
    for (const MapKeyframe& k : map.keyframes)
      trajectory.push_back({k.frame->time_ns, k.T_world_camera});
    return test::absolute_error(trajectory, flight).rmse();
  }
  const test::Flight& flight;
  MapData map;
};

TEST(AdjustAll, ALargeMapIsAdjustedInPieces) {
  test::Simulation s;
  s.camera = test::radtan_camera();
  s.path = test::sideways_path(24);
  s.frames = 400;
  const test::Flight flight = test::Simulator(s).fly();
  BackendOptions options;
  options.max_error_px = 50;
  RoughMap whole(flight), pieces(flight), stopped(flight);
  const double before = whole.error();
  ASSERT_TRUE(adjust_all(whole.map, options, 1, {}, {}));
  options.adjustment_views = 4000;
  ASSERT_TRUE(adjust_all(pieces.map, options, 1, {}, {}));
  std::cout << "  keyframes are off by " << before << " before, " << whole.error()
            << " adjusted at once, " << pieces.error() << " in pieces\n";
  EXPECT_GT(before, 0.03);
  EXPECT_LT(whole.error(), 0.1 * before);
  EXPECT_LT(pieces.error(), 0.2 * before);
  std::stop_source stop;
  stop.request_stop();
  (void)adjust_all(stopped.map, options, 1, {}, stop.get_token());
  EXPECT_EQ(stopped.error(), before) << "asked to stop, it begins no piece";
}

}  // namespace
}  // namespace corvid
