#include "mapping/ray_grid.h"

#include <gtest/gtest.h>

#include <array>
#include <limits>
#include <set>

#include "scenes/plane_views.h"

namespace corvid {
namespace {

using testing::pinhole;

VoxelGrid grid_of(const Eigen::Vector3d& low, const Eigen::Vector3d& high, double voxel) {
  return {Eigen::AlignedBox3d(low, high), voxel};
}

TEST(RayGrid, FarSidesOfAVolumeBeforeTheCamera) {
  const VoxelGrid grid = grid_of({-0.5, -0.4, 4}, {0.5, 0.4, 5}, 0.1);
  EXPECT_EQ(grid.size(), Eigen::Vector3i(10, 8, 10));
  // The camera is between both pairs of sides and in front of the third axis's: five faces.
  const auto rays = far_side_rays(grid, pinhole(200, 160, 300), Pose());
  EXPECT_EQ(rays.size(), 10U * 8 + 2 * 10 * 10 + 2 * 8 * 10);
  // From the side: three faces.
  const auto three = far_side_rays(grid, pinhole(800, 600, 300),
                                   Pose(Eigen::Quaterniond::Identity(), {-1.2, -1.1, 0}));
  EXPECT_EQ(three.size(), 10U * 8 + 10 * 10 + 8 * 10);
  for (const GridRay& ray : three) {
    EXPECT_TRUE(ray.voxel.x() == 9 || ray.voxel.y() == 7 || ray.voxel.z() == 9);
  }
}

TEST(RayGrid, EveryVoxelSeenIsPassedByARay) {
  const VoxelGrid grid = grid_of({-0.5, -0.4, 2}, {0.5, 0.4, 3}, 0.1);
  const Pose T(so3_exp({0.02, -0.1, 0.3}), Eigen::Vector3d(-0.9, 0.7, 0));
  const Camera camera = pinhole(400, 400, 200);
  std::set<std::array<int, 3>> passed;
  for (const GridRay& ray : far_side_rays(grid, camera, T)) {
    const Eigen::Vector3d direction = T.rotation() * camera.unproject(ray.pixel).value();
    for (double t = 0; t < 6; t += 0.005) {
      const Eigen::Vector3d p = T.translation() + t * direction;
      if (!grid.box.contains(p)) continue;
      const Eigen::Vector3d v = (p - grid.box.min()) / grid.voxel_size;
      passed.insert({static_cast<int>(v.x()), static_cast<int>(v.y()), static_cast<int>(v.z())});
    }
  }
  EXPECT_GE(passed.size(), 10U * 8 * 10 - 4) << "a ray may touch a corner only";
}

TEST(RayGrid, NothingWhereThereIsNothing) {
  const Camera camera = pinhole(200, 160, 300);
  EXPECT_TRUE(far_side_rays({}, camera, Pose()).empty());
  EXPECT_TRUE(far_side_rays(grid_of({0, 0, 4}, {1, 1, 5}, 0), camera, Pose()).empty());
  EXPECT_TRUE(far_side_rays(grid_of({0, 0, 4}, {1, 1, 5}, 1e-12), camera, Pose()).empty());
  EXPECT_TRUE(far_side_rays(grid_of({-1, -1, -5}, {1, 1, -4}, 0.1), camera, Pose()).empty());
  EXPECT_FALSE(depth_interval(Eigen::AlignedBox3d(), Pose()).has_value());
  const Eigen::AlignedBox3d behind(Eigen::Vector3d(-1, -1, -5), Eigen::Vector3d(1, 1, -4));
  EXPECT_FALSE(depth_interval(behind, Pose()).has_value());
}

TEST(RayGrid, IntervalAndSamples) {
  const Eigen::AlignedBox3d box(Eigen::Vector3d(-1, -1, 2), Eigen::Vector3d(1, 1, 4));
  const auto interval = depth_interval(box, Pose());
  ASSERT_TRUE(interval.has_value());
  EXPECT_DOUBLE_EQ(interval->near, 2);
  EXPECT_DOUBLE_EQ(interval->far, 4);
  // 300 px * 0.4 / 2 against 300 px * 0.4 / 4: 30 px.
  const Pose shifted(Eigen::Quaterniond::Identity(), {0.4, 0, 0});
  EXPECT_NEAR(depth_samples(pinhole(200, 160, 300), {shifted}, *interval), 30, 1);
  EXPECT_EQ(depth_samples(pinhole(200, 160, 300), {}, *interval), 16);
}

TEST(RayGrid, RaysTakeTheDepthOfTheirPixel) {
  const Camera camera = pinhole(200, 160, 300);
  DepthMap map;
  map.camera = camera;
  map.camera.width_px = 100, map.camera.height_px = 80;
  map.camera.fx_px /= 2, map.camera.fy_px /= 2;
  map.camera.cx_px = (camera.cx_px + 0.5) / 2 - 0.5,
  map.camera.cy_px = (camera.cy_px + 0.5) / 2 - 0.5;
  map.depth = FloatImage(100, 80, 3);
  map.depth(20, 30) = 7;
  const std::vector<GridRay> rays = {{Eigen::Vector3i::Zero(), {40.5, 60.5}},
                                     {Eigen::Vector3i::Zero(), {80, 60}}};
  EXPECT_EQ(depths_of(rays, camera, map), (std::vector<float>{7, 3}));
}

}  // namespace
}  // namespace corvid
