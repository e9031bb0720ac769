#include "mapping/voxel_blocks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "mapping/mesh_checks.h"
#include "mapping/mesher.h"

namespace corvid {
namespace {

constexpr double kVoxel = 0.04;
constexpr double kRadius = 0.8;

Camera small_camera() {
  Camera c;
  c.width_px = 160, c.height_px = 120;
  c.fx_px = c.fy_px = 130;
  c.cx_px = 79.5, c.cy_px = 59.5;
  return c;
}

/// A camera at `position` that looks at the origin.
Pose looking_at_origin(const Eigen::Vector3d& position) {
  const Eigen::Vector3d z = -position.normalized();
  const Eigen::Vector3d x = Eigen::Vector3d(0.1, 0.3, 0.9).cross(z).normalized();
  Eigen::Matrix3d R;
  R << x, z.cross(x), z;
  return {R, position};
}

/// Exact depth of a sphere round the origin.
DepthMap sphere_view(const Pose& T_world_camera, double radius = kRadius) {
  DepthMap map;
  map.camera = small_camera();
  map.T_world_camera = T_world_camera;
  map.depth = FloatImage(map.camera.width_px, map.camera.height_px);
  map.confidence = map.depth;
  for (int y = 0; y < map.depth.height(); ++y) {
    for (int x = 0; x < map.depth.width(); ++x) {
      const Eigen::Vector3d ray = T_world_camera.rotation() * map.camera.unproject({x, y}).value();
      const Eigen::Vector3d c = T_world_camera.translation();
      const double b = ray.dot(c), q = b * b - c.squaredNorm() + radius * radius;
      if (q < 0) continue;
      const Eigen::Vector3d p = T_world_camera.inverse() * (c + (-b - std::sqrt(q)) * ray);
      map.depth(x, y) = static_cast<float>(p.z());
      map.confidence(x, y) = 0.9F;
    }
  }
  return map;
}

std::vector<Pose> poses_all_round() {
  std::vector<Pose> out;
  for (int i = 0; i < 40; ++i) {  // a Fibonacci lattice
    const double h = 1 - (2 * i + 1) / 40.0, a = i * M_PI * (3 - std::sqrt(5.0));
    const double r = std::sqrt(1 - h * h);
    out.push_back(looking_at_origin(2.4 * Eigen::Vector3d(r * std::cos(a), r * std::sin(a), h)));
  }
  return out;
}

ColourImage plain(const DepthMap& map, Rgb8 colour) {
  return {map.depth.width(), map.depth.height(), colour};
}

TEST(VoxelBlocks, SphereSeenFromAllSidesIsClosedAndOfTheRightRadius) {
  VoxelBlocks volume(kVoxel, 10000);
  for (const Pose& T : poses_all_round()) {
    const DepthMap map = sphere_view(T);
    (void)volume.fuse(map, plain(map, {10, 200, 30}), T, T.translation());
  }
  const TriangleMesh mesh = mesh_all(volume);
  ASSERT_GT(mesh.triangles.size(), 1000U);
  EXPECT_TRUE(testing::topology(mesh).closed_manifold());
  std::vector<double> errors;
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Vector3d v = mesh.vertices[i].cast<double>();
    errors.push_back(std::abs(v.norm() - kRadius));
    EXPECT_GT(v.normalized().dot(mesh.normals[i].cast<double>()), 0.8);
    EXPECT_EQ(mesh.colours[i], (Rgb8{10, 200, 30}));
  }
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[errors.size() / 2], 0.25 * kVoxel);
  EXPECT_LT(errors.back(), kVoxel);
  EXPECT_GT(testing::volume(mesh), 0);
}

TEST(VoxelBlocks, UnfuseIsTheInverseOfFuseInAnyOrder) {
  VoxelBlocks volume(kVoxel, 10000);
  const std::vector<Pose> poses = poses_all_round();
  std::vector<DepthMap> maps;
  std::vector<FusedView> views;
  for (std::size_t i = 0; i < 8; ++i) maps.push_back(sphere_view(poses[5 * i]));
  const auto colour = [&](std::size_t i) {
    return plain(maps[i], {static_cast<std::uint8_t>(30 * i), 77, 5});
  };
  for (std::size_t i = 0; i < 4; ++i) {
    views.push_back(volume.fuse(maps[i], colour(i), poses[5 * i], Eigen::Vector3d::Zero()));
  }
  std::vector<std::pair<BlockIndex, VoxelBlock>> before;
  for (const BlockIndex& b : volume.indices()) before.emplace_back(b, *volume.find(b));
  for (std::size_t i = 4; i < 8; ++i) {
    views.push_back(volume.fuse(maps[i], colour(i), poses[5 * i], Eigen::Vector3d::Zero()));
  }
  for (const std::size_t i : {5U, 4U, 7U, 6U}) volume.unfuse(views[i], maps[i], colour(i));
  ASSERT_EQ(volume.size(), before.size());
  for (const auto& [index, block] : before) {
    ASSERT_NE(volume.find(index), nullptr);
    EXPECT_EQ(volume.find(index)->voxels, block.voxels);
  }
  for (const std::size_t i : {2U, 0U, 3U, 1U}) volume.unfuse(views[i], maps[i], colour(i));
  EXPECT_EQ(volume.size(), 0U);
  EXPECT_TRUE(mesh_all(volume).empty());
}

TEST(VoxelBlocks, AnotherDepthMapDoesNotUnfuse) {
  // The check above must be able to fail: one ray that differs leaves something behind.
  const Pose T = poses_all_round()[3];
  const DepthMap map = sphere_view(T);
  DepthMap other = map;
  other.depth(80, 60) *= 1.01F;
  for (const bool same : {true, false}) {
    VoxelBlocks volume(kVoxel, 10000);
    (void)volume.fuse(map, {}, T, T.translation());
    const FusedView view = volume.fuse(map, {}, T, T.translation());
    VoxelBlocks once(kVoxel, 10000);
    (void)once.fuse(map, {}, T, T.translation());
    volume.unfuse(view, same ? map : other, {});
    int differing = 0;
    for (const BlockIndex& b : once.indices()) {
      differing += volume.find(b) == nullptr || volume.find(b)->voxels != once.find(b)->voxels;
    }
    EXPECT_EQ(differing == 0, same);
  }
}

TEST(VoxelBlocks, AViewThatSeesThroughASurfaceCarvesIt) {
  VoxelBlocks volume(kVoxel, 10000);
  const Pose T = poses_all_round()[0];
  const DepthMap wrong = sphere_view(T, 1.2), right = sphere_view(T, 0.8);
  (void)volume.fuse(wrong, {}, T, T.translation());
  // Round the line of sight, where the smaller sphere hides the larger one's front.
  const auto front_of_wrong_sphere = [&] {
    const TriangleMesh mesh = mesh_all(volume);
    const Eigen::Vector3f to_camera = T.translation().cast<float>().normalized();
    return std::count_if(mesh.vertices.begin(), mesh.vertices.end(), [&](const Eigen::Vector3f& v) {
      return v.norm() > 1.1F && v.normalized().dot(to_camera) > 0.95F;
    });
  };
  ASSERT_GT(front_of_wrong_sphere(), 100);
  for (int i = 0; i < 4; ++i) (void)volume.fuse(right, {}, T, T.translation());
  EXPECT_EQ(front_of_wrong_sphere(), 0);
}

TEST(VoxelBlocks, BlocksThatOnlyFreeSpaceIsKnownOfAreNotKept) {
  VoxelBlocks volume(kVoxel, 10000);
  const Pose T = poses_all_round()[0];
  const DepthMap near = sphere_view(T, 1.2), far = sphere_view(T, 0.8);
  const FusedView first = volume.fuse(near, {}, T, T.translation());
  const FusedView second = volume.fuse(far, {}, T, T.translation());
  const std::size_t both = volume.size();
  volume.unfuse(first, near, {});
  EXPECT_LT(volume.size(), both);
  for (const BlockIndex& b : volume.indices()) EXPECT_EQ(volume.find(b)->surface_views, 1);
  volume.unfuse(second, far, {});
  EXPECT_EQ(volume.size(), 0U);
}

TEST(VoxelBlocks, BudgetHoldsAndTheFarthestGoFirst) {
  VoxelBlocks unbounded(kVoxel, 100000), volume(kVoxel, 60);
  const Pose T = poses_all_round()[7], T2 = poses_all_round()[30];
  const DepthMap map = sphere_view(T), map2 = sphere_view(T2);
  (void)unbounded.fuse(map, {}, T, T.translation());
  ASSERT_GT(unbounded.size(), 60U);
  const FusedView view = volume.fuse(map, {}, T, T.translation());
  EXPECT_LE(volume.size(), 60U);
  EXPECT_GT(volume.dropped_blocks(), 0U);
  const auto distance = [&](const BlockIndex& b) {
    return ((Eigen::Vector3d(b.x, b.y, b.z) + Eigen::Vector3d::Constant(0.5)) * 8 * kVoxel -
            T2.translation())
        .norm();
  };
  (void)volume.take_changed();
  const std::vector<BlockIndex> before = volume.indices();
  const FusedView view2 = volume.fuse(map2, {}, T2, T2.translation());
  EXPECT_LE(volume.size(), 60U);
  const std::vector<BlockIndex> changed = volume.take_changed();
  double farthest_kept = 0, nearest_gone = 1e9;
  for (const BlockIndex& b : volume.indices()) farthest_kept = std::max(farthest_kept, distance(b));
  for (const BlockIndex& b : before) {
    if (volume.find(b)) continue;
    nearest_gone = std::min(nearest_gone, distance(b));
    EXPECT_TRUE(std::binary_search(changed.begin(), changed.end(), b));
  }
  EXPECT_LE(farthest_kept, nearest_gone + 1e-9);
  // What was dropped is simply not there to be taken out.
  volume.unfuse(view, map, {});
  volume.unfuse(view2, map2, {});
  EXPECT_EQ(volume.size(), 0U);
}

TEST(VoxelBlocks, AFarCameraAndAnEmptyMapChangeNothing) {
  VoxelBlocks volume(kVoxel, 1000);
  DepthMap map = sphere_view(poses_all_round()[0]);
  const Pose far(Eigen::Quaterniond::Identity(), Eigen::Vector3d(1e12, 0, 0));
  EXPECT_TRUE(volume.fuse(map, {}, far, far.translation()).blocks.empty());
  map.depth = map.confidence = FloatImage(160, 120);
  EXPECT_TRUE(volume.fuse(map, {}, map.T_world_camera, {0, 0, 0}).blocks.empty());
  EXPECT_EQ(volume.size(), 0U);
  EXPECT_TRUE(volume.take_changed().empty());
}

}  // namespace
}  // namespace corvid
