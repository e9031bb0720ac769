// Lost and found, end to end: flights over the synthetic town.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <vector>

#include "core/alignment.h"
#include "corvid/engine.h"
#include "replay/synthetic_flight.h"
#include "scenes/flight_of.h"

namespace corvid {
namespace {

FlightOptions round_flight() {
  FlightOptions options;
  options.width_px = 352;
  options.height_px = 264;
  options.colour = false;
  options.duration_s = 30;
  options.rate_hz = 6;
  options.path = FlightPath::loop;
  return options;
}

/// A flight whose frames are rendered once for all tests.
const scenes::RenderedFlight& rendered() {
  static const scenes::RenderedFlight once(round_flight());
  return once;
}

/// Frames of the flight in any order, with rising times; kDark is a covered lens.
class Reordered final : public FrameSource {
 public:
  static constexpr int kDark = -1;
  explicit Reordered(std::vector<int> order)
      : flight_(rendered().flight), order_(std::move(order)), info_(flight_.info()) {
    info_.frames = order_.size();
  }
  const SourceInfo& info() const override { return info_; }
  Expected<FramePtr> next(const std::stop_token&) override {
    if (given_ >= order_.size()) return FramePtr();
    const int from = order_[given_];
    auto frame = std::make_shared<Frame>(*rendered().frames[std::size_t(std::max(from, 0))]);
    if (from < 0) frame->grey = GreyImage(frame->grey.width(), frame->grey.height(), 4);
    frame->id = FrameId(static_cast<std::uint32_t>(given_));
    frame->time_ns = flight_.time_ns(given_);
    ++given_;
    return FramePtr(std::move(frame));
  }
  SourceCounts counts() const override { return {given_, 0, 0, {}}; }
  [[nodiscard]] Trajectory truth() const override {
    Trajectory truth;
    for (std::size_t i = 0; i < order_.size(); ++i)
      if (order_[i] >= 0)
        truth.push_back({flight_.time_ns(i), flight_.true_pose(std::size_t(order_[i]))});
    return truth;
  }

 private:
  const SyntheticFlight& flight_;
  std::vector<int> order_;
  SourceInfo info_;
  std::size_t given_ = 0;
};

std::vector<int> frames(int first, int end) {
  std::vector<int> list;
  for (int i = first; i < end; ++i) list.push_back(i);
  return list;
}

std::vector<int> operator+(std::vector<int> a, const std::vector<int>& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

RunResult run(FrameSource& source, bool mapping = false) {
  Options options;
  options.threads = 1;
  options.frontend.max_tracks = 400;
  options.mapping.enabled = mapping;
  options.mapping.depth_samples = 64;
  options.mapping.depth_scale = 3;
  auto engine = Engine::create(options);
  if (!engine) throw std::runtime_error(engine.error().to_string());
  auto result = (*engine)->run(source);
  if (!result) throw std::runtime_error(result.error().to_string());
  return std::move(*result);
}

PointAlignment align(const RunResult& result, const Trajectory& truth) {
  std::map<std::int64_t, Eigen::Vector3d> at;
  for (const StampedPose& p : truth) at[p.time_ns] = p.T_world_camera.translation();
  std::vector<Eigen::Vector3d> estimate, true_places;
  for (const StampedPose& p : result.trajectory) {
    if (!at.contains(p.time_ns)) continue;
    estimate.push_back(p.T_world_camera.translation());
    true_places.push_back(at[p.time_ns]);
  }
  return align_points(estimate, true_places, true);
}

double length(const Trajectory& t) {
  double way = 0;
  for (std::size_t i = 1; i < t.size(); ++i)
    way += (t[i].T_world_camera.translation() - t[i - 1].T_world_camera.translation()).norm();
  return way;
}

/// Distances of the mesh from the true surface, along the rays of a frame, of what it sees [m].
std::vector<double> surface_errors(const RunResult& result, const Sim3& T_truth_map,
                                   std::size_t frame) {
  const SyntheticFlight& flight = rendered().flight;
  const Pose T_camera_world = flight.true_pose(frame).inverse();
  const FloatImage depth = flight.render_depth(frame);
  std::vector<double> errors;
  for (const Eigen::Vector3f& v : result.mesh.vertices) {
    const Eigen::Vector3d p = T_camera_world * (T_truth_map * Eigen::Vector3d(v.cast<double>()));
    const auto pixel = flight.camera().project(p);
    if (!pixel || !flight.camera().in_image(*pixel, 2)) continue;
    const auto z = static_cast<double>(depth(static_cast<int>(std::lround(pixel->x())),
                                             static_cast<int>(std::lround(pixel->y()))));
    // What lies far behind is hidden by something else.
    if (z > 0 && std::abs(p.z() - z) < 0.1 * z) errors.push_back(std::abs(p.z() - z));
  }
  std::sort(errors.begin(), errors.end());
  return errors;
}

TEST(Places, ARoundEndsWhereItBeganAndHasOneWall) {
  const SyntheticFlight& flight = rendered().flight;
  const int count = static_cast<int>(flight.frame_count());
  Reordered source(frames(0, count));
  const RunResult result = run(source, true);
  ASSERT_EQ(result.trajectory.size(), flight.frame_count());
  EXPECT_GE(result.places.loops + result.places.connections, 1);
  const double gap = (result.trajectory.back().T_world_camera.translation() -
                      result.trajectory.front().T_world_camera.translation())
                         .norm() /
                     length(result.trajectory);
  const PointAlignment alignment = align(result, flight.truth());
  ASSERT_TRUE(alignment.ok());
  std::printf("gap %.4f %% of the way, error %.4f m of %.1f m, %d loops, %d connections\n",
              100 * gap, alignment.rmse, length(flight.truth()), result.places.loops,
              result.places.connections);
  EXPECT_LT(gap, 5e-4);

  // What was seen at the beginning and at the end is as thin as what was seen once.
  const auto twice = surface_errors(result, alignment.T_target_source, 0);
  const auto once = surface_errors(result, alignment.T_target_source, flight.frame_count() / 2);
  ASSERT_GT(std::min(twice.size(), once.size()), 500U);
  for (const double share : {0.5, 0.8}) {
    const auto at = [&](const std::vector<double>& v) {
      return v[static_cast<std::size_t>(share * static_cast<double>(v.size()))];
    };
    std::printf("mesh: %.0f %% within %.3f m, elsewhere %.3f m, voxels %.3f m\n", 100 * share,
                at(twice), at(once), result.voxel_size * alignment.T_target_source.scale());
    EXPECT_LT(at(twice), 1.5 * at(once));
  }
}

TEST(Places, AKidnappedCameraIsFoundAgain) {
  Trajectory first;
  for (int i = 0; i < 2; ++i) {
    Reordered source(frames(0, 70) + frames(15, 45));
    const RunResult result = run(source);
    EXPECT_GE(result.places.relocalizations + result.places.merges, 1);
    EXPECT_EQ(result.events.back().segment, 0);
    EXPECT_GE(result.events.back().resets, 1U);
    const PointAlignment alignment = align(result, source.truth());
    std::printf("%zu poses, error %.4f m\n", result.trajectory.size(), alignment.rmse);
    EXPECT_GE(result.trajectory.size(), 80U);
    EXPECT_LT(alignment.rmse, 0.001 * length(source.truth()));
    if (i == 0) first = result.trajectory;
    ASSERT_EQ(result.trajectory.size(), first.size());
    for (std::size_t k = 0; k < first.size(); ++k)
      EXPECT_EQ(result.trajectory[k].T_world_camera.translation(),
                first[k].T_world_camera.translation());
  }
}

TEST(Places, ALensCoveredForFiveSeconds) {
  Reordered source(frames(0, 50) + std::vector<int>(30, Reordered::kDark) + frames(30, 55));
  const RunResult result = run(source);
  EXPECT_GE(result.places.relocalizations + result.places.merges, 1);
  EXPECT_EQ(result.events.back().segment, 0);
  EXPECT_TRUE(result.events.back().T_world_camera);
  const PointAlignment alignment = align(result, source.truth());
  std::printf("%zu poses, error %.4f m\n", result.trajectory.size(), alignment.rmse);
  EXPECT_LT(alignment.rmse, 0.001 * length(source.truth()));
}

}  // namespace
}  // namespace corvid
