#include "mapping/still_depth.h"

#include <gtest/gtest.h>

#include <cmath>

#include "scenes/plane_views.h"

namespace corvid {
namespace {

std::shared_ptr<Device> device() {
  static const auto opened = Device::open("auto");
  if (!opened) throw std::runtime_error(opened.error().to_string());
  return *opened;
}

/// A ball before a wall, seen from an arc; all look at the ball.
std::vector<StillView> arc(int count) {
  testing::PlaneScene scene;
  scene.planes = {{Eigen::Vector3d(0, 0, 1), 4.5}};
  scene.spheres = {{Eigen::Vector3d(0, 0, 3), 0.7}};
  scene.finest = 0.07;
  const auto camera = std::make_shared<const Camera>(testing::pinhole(160, 120, 150));
  std::vector<StillView> views;
  for (int i = 0; i < count; ++i) {
    const double angle = 0.09 * (i - 0.5 * (count - 1));
    const Pose T(so3_exp({0, angle, 0}),
                 Eigen::Vector3d(-3 * std::sin(angle), 0, 3 - 3 * std::cos(angle)));
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(i));
    frame->grey = scene.render(*camera, T);
    frame->camera = camera;
    views.push_back({frame, T});
  }
  return views;
}

double off_surface(const Eigen::Vector3f& p) {
  const Eigen::Vector3d q = p.cast<double>();
  return std::min(std::abs(q.z() - 4.5), std::abs((q - Eigen::Vector3d(0, 0, 3)).norm() - 0.7));
}

TEST(StillDepth, PointsThatThreeViewsAgreeOnLieOnTheSurface) {
  const auto views = arc(7);
  const auto depths = depth_of_stills(device(), views, {});
  ASSERT_TRUE(depths.has_value()) << depths.error().to_string();
  for (const StillDepth& d : *depths) {
    EXPECT_TRUE(d.refusal.empty()) << d.refusal;
    EXPECT_GT(d.answered, 0.5);
  }
  const TriangleMesh points = agreed_points(views, *depths);
  ASSERT_GT(points.vertices.size(), 20000U);
  ASSERT_EQ(points.colours.size(), points.vertices.size());
  std::size_t near_surface = 0;
  for (const auto& p : points.vertices) near_surface += off_surface(p) < 0.05;
  EXPECT_GT(static_cast<double>(near_surface), 0.95 * static_cast<double>(points.vertices.size()));
  EXPECT_LT(agreed_points(views, *depths, 6).vertices.size(), points.vertices.size());
}

TEST(StillDepth, AViewThatLooksAwayIsRefusedAndTheOthersAreNot) {
  auto views = arc(7);
  views[2].T_world_camera =
      views[2].T_world_camera * Pose(so3_exp({0, 3.1, 0}), Eigen::Vector3d::Zero());
  const auto depths = depth_of_stills(device(), views, {});
  ASSERT_TRUE(depths.has_value()) << depths.error().to_string();
  EXPECT_FALSE((*depths)[2].refusal.empty());
  EXPECT_TRUE((*depths)[4].refusal.empty());
}

TEST(StillDepth, WhatCannotBeIsRefusedWithItsReason) {
  const auto views = arc(5);
  EXPECT_FALSE(depth_of_stills(device(), {}, {}));
  EXPECT_FALSE(depth_of_stills(device(), std::span(views).first(2), {}));
  auto same = views;
  for (StillView& view : same) view = views[0];
  EXPECT_FALSE(depth_of_stills(device(), same, {}));
  auto parallel = views;
  for (int i = 0; i < 5; ++i)
    parallel[static_cast<std::size_t>(i)].T_world_camera =
        Pose(Eigen::Quaterniond::Identity(), {0.1 * i, 0, 0});
  EXPECT_FALSE(depth_of_stills(device(), parallel, {}));
  // A scale that is off by 1000 against the given interval: no view has depth, each with a reason.
  StillDepthOptions far;
  far.interval = DepthInterval{2000, 6000};
  const auto depths = depth_of_stills(device(), views, far);
  ASSERT_TRUE(depths.has_value());
  for (const StillDepth& d : *depths) EXPECT_FALSE(d.refusal.empty());
  EXPECT_TRUE(agreed_points(views, *depths).vertices.empty());
}

TEST(StillDepth, ThePointThatCamerasLookAt) {
  std::vector<Pose> poses;
  for (const StillView& view : arc(5)) poses.push_back(view.T_world_camera);
  const auto p = point_looked_at(poses);
  ASSERT_TRUE(p.has_value());
  EXPECT_LT((*p - Eigen::Vector3d(0, 0, 3)).norm(), 1e-6);
  EXPECT_FALSE(point_looked_at({}).has_value());
}

}  // namespace
}  // namespace corvid
