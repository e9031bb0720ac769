#include "mapping/still_depth.h"

#include <gtest/gtest.h>

#include "mapping/cut_mesh.h"
#include "mapping/still_cut.h"
#include "scenes/ball_views.h"

namespace corvid {
namespace {

std::shared_ptr<Device> device() {
  static const auto opened = Device::open("auto");
  if (!opened) throw std::runtime_error(opened.error().to_string());
  return *opened;
}

using testing::ball_views;

TEST(StillDepth, PointsThatThreeViewsAgreeOnLieOnTheSurface) {
  const auto views = ball_views(7);
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
  for (const auto& p : points.vertices) near_surface += testing::off_ball_and_wall(p) < 0.05;
  EXPECT_GT(static_cast<double>(near_surface), 0.95 * static_cast<double>(points.vertices.size()));
  EXPECT_LT(agreed_points(views, *depths, 6).vertices.size(), points.vertices.size());
}

TEST(StillDepth, AViewThatLooksAwayIsRefusedAndTheOthersAreNot) {
  auto views = ball_views(7);
  views[2].T_world_camera =
      views[2].T_world_camera * Pose(so3_exp({0, 3.1, 0}), Eigen::Vector3d::Zero());
  const auto depths = depth_of_stills(device(), views, {});
  ASSERT_TRUE(depths.has_value()) << depths.error().to_string();
  EXPECT_FALSE((*depths)[2].refusal.empty());
  EXPECT_TRUE((*depths)[4].refusal.empty());
}

TEST(StillDepth, WhatCannotBeIsRefusedWithItsReason) {
  const auto views = ball_views(5);
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

TEST(StillDepth, TooManyRaysAtATimeAreRefusedWithWhatToDo) {
  auto frame = std::make_shared<Frame>();
  frame->grey = GreyImage(6000, 4000);
  frame->camera = std::make_shared<const Camera>(testing::pinhole(6000, 4000, 5000));
  std::vector<StillView> views;
  for (int i = 0; i < 17; ++i) {
    const double angle = 0.03 * (i - 8);
    views.push_back(
        {frame, Pose(so3_exp({0, angle, 0}), {-3 * std::sin(angle), 0, 3 - 3 * std::cos(angle)})});
  }
  StillDepthOptions options;
  options.neighbours = 16;
  options.interval = DepthInterval{1.5, 6};
  const auto depths = depth_of_stills(device(), views, options);
  ASSERT_TRUE(depths.has_value()) << depths.error().to_string();
  for (const StillDepth& d : *depths) {
    EXPECT_EQ(d.neighbours, 16);
    EXPECT_NE(d.refusal.find("--scale"), std::string::npos) << d.refusal;
    EXPECT_EQ(d.map.depth.size(), 0U);
  }
}

TEST(StillDepth, ThePointThatCamerasLookAt) {
  std::vector<Pose> poses;
  for (const StillView& view : ball_views(5)) poses.push_back(view.T_world_camera);
  const auto p = point_looked_at(poses);
  ASSERT_TRUE(p.has_value());
  EXPECT_LT((*p - Eigen::Vector3d(0, 0, 3)).norm(), 1e-6);
  EXPECT_FALSE(point_looked_at({}).has_value());
}

TEST(StillDepth, ASurfaceThroughThem) {
  const auto views = ball_views(7);
  const auto depths = depth_of_stills(device(), views, {});
  ASSERT_TRUE(depths.has_value()) << depths.error().to_string();
  SurfaceCutOptions options;
  options.box = Eigen::AlignedBox3d(Eigen::Vector3d(-0.9, -0.9, 2.1), Eigen::Vector3d(0.9, 0.9, 3));
  options.voxel_size = 0.03;
  options.closed = false;  // the ball's back was seen by nobody
  const auto cut = cut_stills(views, *depths, options);
  ASSERT_TRUE(cut.has_value()) << cut.error().to_string();
  ASSERT_GT(cut->mesh.vertices.size(), 1000U);
  EXPECT_EQ(cut->mesh.colours.size(), cut->mesh.vertices.size());
  std::size_t near_surface = 0;
  for (const auto& p : cut->mesh.vertices) near_surface += testing::off_ball_and_wall(p) < 0.03;
  EXPECT_GT(static_cast<double>(near_surface),
            0.9 * static_cast<double>(cut->mesh.vertices.size()));
  options.closed = true;
  const auto closed = cut_stills(views, *depths, options);
  ASSERT_TRUE(closed.has_value()) << closed.error().to_string();
  EXPECT_EQ(unpaired_sides(closed->mesh), 0U);
  EXPECT_GT(unpaired_sides(cut->mesh), 0U);
}

TEST(StillDepth, WithoutDepthThereIsNoSurface) {
  const auto views = ball_views(5);
  const auto depths = depth_of_stills(device(), views, {});
  ASSERT_TRUE(depths.has_value()) << depths.error().to_string();
  EXPECT_FALSE(cut_stills(views, *depths, {}, {}, 6).has_value());  // more than there are views
  EXPECT_FALSE(cut_stills(views, {}, {}).has_value());
}

}  // namespace
}  // namespace corvid
