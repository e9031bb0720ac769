#include <gtest/gtest.h>

#include <cstdio>
#include <random>

#include "core/geodesy.h"
#include "corvid/engine.h"
#include "replay/synthetic_flight.h"
#include "scenes/flight_of.h"

namespace corvid {
namespace {

constexpr double kSigma_m = 0.05;
const GeodeticPosition kOrigin{0.82, 0.15, 430};

/// The flight, rendered once.
const scenes::RenderedFlight& rendered() {
  static const scenes::RenderedFlight once(scenes::flight_of(400, 300, 4));
  return once;
}

Options engine_options(int threads) {
  Options options;
  options.threads = threads;
  options.frontend.max_tracks = 400;
  options.mapping.enabled = false;
  return options;
}

/// The flight; a receiver hears a position with every second frame, on the thread that captures.
class FlightWithReceiver final : public FrameSource {
 public:
  explicit FlightWithReceiver(PositionFeed& feed) : feed_(feed) {}
  const SourceInfo& info() const override { return flight_.info(); }
  SourceCounts counts() const override { return {given_, 0, 0, {}}; }
  Expected<FramePtr> next(const std::stop_token&) override {
    if (given_ == flight_.frame_count()) return FramePtr();
    if (given_ % 2 == 0) {
      PositionFix fix;
      fix.time_ns = flight_.time_ns(given_);
      const Eigen::Vector3d noise(normal_(random_), normal_(random_), normal_(random_));
      fix.position = to_geodetic(
          LocalFrame(kOrigin).to_ecef(flight_.true_pose(given_).translation() + kSigma_m * noise));
      fix.covariance_m2 = kSigma_m * kSigma_m * Eigen::Matrix3d::Identity();
      EXPECT_TRUE(feed_.push(fix));
    }
    return rendered().frames[given_++];
  }
  [[nodiscard]] Eigen::Vector3d true_position(std::int64_t time_ns,
                                              const GeodeticPosition& origin) const {
    for (std::size_t i = 0; i < flight_.frame_count(); ++i)
      if (flight_.time_ns(i) == time_ns)
        return LocalFrame(origin).to_enu(
            LocalFrame(kOrigin).to_ecef(flight_.true_pose(i).translation()));
    ADD_FAILURE() << "no frame at " << time_ns;
    return Eigen::Vector3d::Zero();
  }

 private:
  PositionFeed& feed_;
  const SyntheticFlight& flight_ = rendered().flight;
  std::size_t given_ = 0;
  std::mt19937_64 random_{5};
  std::normal_distribution<double> normal_;
};

TEST(EnginePositions, AFeedFromAnotherThreadMakesTheMapMetric) {
  for (const int threads : {1, 3}) {
    PositionFeed feed;
    FlightWithReceiver source(feed);
    auto engine = Engine::create(engine_options(threads));
    ASSERT_TRUE(engine) << engine.error().to_string();
    const auto result = (*engine)->run(source, {}, {}, &feed);
    ASSERT_TRUE(result) << result.error().to_string();
    std::size_t metric = 0;
    double worst_live_m = 0, worst_m = 0;
    for (const PoseEvent& e : result->events) {
      if (e.scale != MapScale::metric || !e.T_world_camera) continue;
      ++metric;
      const Eigen::Vector3d p = e.placement->T_enu_map * e.T_world_camera->translation();
      worst_live_m =
          std::max(worst_live_m, (p - source.true_position(e.time_ns, e.placement->origin)).norm());
    }
    ASSERT_EQ(result->placements.size(), 1U);
    const MapPlacement& placement = result->placements[0];
    ASSERT_EQ(placement.scale, MapScale::metric) << placement.reason;
    for (const StampedPose& p : result->trajectory)
      worst_m = std::max(worst_m, (placement.T_enu_map * p.T_world_camera.translation() -
                                   source.true_position(p.time_ns, placement.origin))
                                      .norm());
    std::printf("%d threads: %zu of %zu poses metric, worst %.3f m live, %.3f m at the end\n",
                threads, metric, result->events.size(), worst_live_m, worst_m);
    EXPECT_GE(metric, result->events.size() / 5);
    EXPECT_LT(worst_live_m, 1.0);
    EXPECT_LT(worst_m, 0.15);
    EXPECT_TRUE(feed.take().empty());
  }
}

/// Asks to stop when the engine, at its end, asks for the last positions.
class StopAtTheEnd final : public PositionSource {
 public:
  StopAtTheEnd(std::stop_source& stop, std::size_t frames) : stop_(stop), left_(frames) {}
  [[nodiscard]] std::vector<PositionFix> take() override {
    if (left_-- == 0) stop_.request_stop();
    return {};
  }

 private:
  std::stop_source& stop_;
  std::size_t left_;
};

TEST(EnginePositions, AStopWhileTheWholeMapIsAdjustedIsTold) {
  for (const int threads : {1, 2}) {
    PositionFeed unheard;
    FlightWithReceiver flight(unheard);
    const std::size_t frames = rendered().frames.size();
    std::stop_source stop;
    StopAtTheEnd last(stop, frames);
    auto engine = Engine::create(engine_options(threads));
    ASSERT_TRUE(engine) << engine.error().to_string();
    const auto result = (*engine)->run(flight, {}, stop.get_token(), &last);
    ASSERT_TRUE(result) << result.error().to_string();
    EXPECT_TRUE(result->interrupted);
    EXPECT_EQ(result->trajectory.size(), frames);
    ASSERT_FALSE(result->notes.empty());
    EXPECT_NE(result->notes.back().find("stopped before its end"), std::string::npos);
  }
}

}  // namespace
}  // namespace corvid
