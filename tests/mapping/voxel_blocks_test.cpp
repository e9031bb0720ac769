#include "mapping/voxel_blocks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "mapping/mesh_checks.h"
#include "mapping/mesher.h"
#include "scenes/memory_archive.h"

namespace corvid {
namespace {

constexpr double kVoxel = 0.04, kFine = 0.02;
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
  VoxelBlocks volume(kVoxel);
  for (const Pose& T : poses_all_round()) {
    const DepthMap map = sphere_view(T);
    (void)volume.fuse(map, plain(map, {10, 200, 30}), T);
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
  VoxelBlocks volume(kVoxel);
  const std::vector<Pose> poses = poses_all_round();
  std::vector<DepthMap> maps;
  std::vector<FusedView> views;
  for (std::size_t i = 0; i < 8; ++i) maps.push_back(sphere_view(poses[5 * i]));
  const auto colour = [&](std::size_t i) {
    return plain(maps[i], {static_cast<std::uint8_t>(30 * i), 77, 5});
  };
  for (std::size_t i = 0; i < 4; ++i) {
    views.push_back(volume.fuse(maps[i], colour(i), poses[5 * i]));
  }
  std::vector<std::pair<BlockIndex, VoxelBlock>> before;
  for (const BlockIndex& b : volume.indices()) before.emplace_back(b, *volume.find(b));
  for (std::size_t i = 4; i < 8; ++i) {
    views.push_back(volume.fuse(maps[i], colour(i), poses[5 * i]));
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
    VoxelBlocks volume(kVoxel);
    (void)volume.fuse(map, {}, T);
    const FusedView view = volume.fuse(map, {}, T);
    VoxelBlocks once(kVoxel);
    (void)once.fuse(map, {}, T);
    volume.unfuse(view, same ? map : other, {});
    int differing = 0;
    for (const BlockIndex& b : once.indices()) {
      differing += volume.find(b) == nullptr || volume.find(b)->voxels != once.find(b)->voxels;
    }
    EXPECT_EQ(differing == 0, same);
  }
}

TEST(VoxelBlocks, ColoursAndDepthThatAreNoLongerToBeHad) {
  const Pose T = poses_all_round()[3];
  const DepthMap map = sphere_view(T);
  const ColourImage red = plain(map, {250, 40, 0}), blue = plain(map, {0, 0, 200});
  VoxelBlocks once(kVoxel), volume(kVoxel);
  (void)once.fuse(map, red, T);
  (void)volume.fuse(map, red, T);
  // Without colour in and with colour out; and the other way round, which leaves a mean of both.
  const FusedView grey = volume.fuse(map, {}, T);
  volume.unfuse(grey, map, blue);
  for (const BlockIndex& b : once.indices()) {
    EXPECT_EQ(volume.find(b)->voxels, once.find(b)->voxels);
  }
  for (int i = 0; i < 40; ++i) {
    const FusedView view = volume.fuse(map, blue, T);
    volume.unfuse(view, map, {});
  }
  for (const BlockIndex& b : once.indices()) {
    for (std::size_t i = 0; i < VoxelBlock::kVoxels; ++i) {
      const Voxel is = volume.find(b)->voxels[i], was = once.find(b)->voxels[i];
      ASSERT_EQ(is.sum_colour_weight, was.sum_colour_weight);
      ASSERT_EQ(is.sum_distance, was.sum_distance);
      ASSERT_LE(is.sum_blue, 255 * was.sum_colour_weight);
      ASSERT_LE(is.sum_red, was.sum_red);
    }
  }
  // Then what was known is taken out: no sum goes below zero.
  const FusedView known = volume.fuse(map, red, T);
  volume.unfuse(volume.fuse(map, blue, T), map, {});
  volume.unfuse(known, map, red);
  for (const BlockIndex& b : once.indices()) {
    for (const Voxel& voxel : volume.find(b)->voxels) {
      ASSERT_LE(voxel.sum_red, 255 * voxel.sum_colour_weight);
      ASSERT_LE(voxel.sum_blue, 255 * voxel.sum_colour_weight);
    }
  }
  // A depth map that is gone changes nothing.
  (void)volume.take_changed();
  DepthMap gone = map;
  gone.depth = gone.confidence = {};
  EXPECT_TRUE(volume.fuse(gone, red, T).blocks.empty());
  volume.unfuse(known, gone, red);
  EXPECT_TRUE(volume.take_changed().empty());
}

TEST(VoxelBlocks, AViewThatSeesThroughASurfaceCarvesIt) {
  VoxelBlocks volume(kVoxel);
  const Pose T = poses_all_round()[0];
  const DepthMap wrong = sphere_view(T, 1.2), right = sphere_view(T, 0.8);
  (void)volume.fuse(wrong, {}, T);
  // Round the line of sight, where the smaller sphere hides the larger one's front.
  const auto front_of_wrong_sphere = [&] {
    const TriangleMesh mesh = mesh_all(volume);
    const Eigen::Vector3f to_camera = T.translation().cast<float>().normalized();
    return std::count_if(mesh.vertices.begin(), mesh.vertices.end(), [&](const Eigen::Vector3f& v) {
      return v.norm() > 1.1F && v.normalized().dot(to_camera) > 0.95F;
    });
  };
  ASSERT_GT(front_of_wrong_sphere(), 100);
  for (int i = 0; i < 4; ++i) (void)volume.fuse(right, {}, T);
  EXPECT_EQ(front_of_wrong_sphere(), 0);
}

TEST(VoxelBlocks, BlocksThatOnlyFreeSpaceIsKnownOfAreNotKept) {
  VoxelBlocks volume(kVoxel);
  const Pose T = poses_all_round()[0];
  const DepthMap near = sphere_view(T, 1.2), far = sphere_view(T, 0.8);
  const FusedView first = volume.fuse(near, {}, T);
  const FusedView second = volume.fuse(far, {}, T);
  const std::size_t both = volume.size();
  volume.unfuse(first, near, {});
  EXPECT_LT(volume.size(), both);
  for (const BlockIndex& b : volume.indices()) EXPECT_EQ(volume.find(b)->surface_views, 1);
  volume.unfuse(second, far, {});
  EXPECT_EQ(volume.size(), 0U);
}

/// The budget of the fewest blocks that a store takes.
constexpr VoxelBudget kSmall{0, 1UL << 30};

/// The same views into a volume with and one without a budget: what differs.
int differing_blocks(const VoxelBlocks& volume, const VoxelBlocks& other) {
  int differing = std::abs(static_cast<int>(volume.size()) - static_cast<int>(other.size()));
  for (const BlockIndex& b : other.indices()) {
    const VoxelBlock* block = volume.find(b);
    differing += block == nullptr || block->voxels != other.find(b)->voxels;
  }
  return differing;
}

TEST(VoxelBlocks, ASpentBudgetChangesNothing) {
  VoxelBlocks unbounded(kFine), volume(kFine, kSmall, std::make_shared<testing::MemoryArchive>());
  std::vector<FusedView> views;
  std::vector<DepthMap> maps;
  for (std::size_t i = 0; i < 8; ++i) {
    const Pose T = poses_all_round()[5 * i];
    maps.push_back(sphere_view(T));
    (void)unbounded.fuse(maps[i], plain(maps[i], {1, 2, 3}), T);
    views.push_back(volume.fuse(maps[i], plain(maps[i], {1, 2, 3}), T));
    EXPECT_LE(volume.in_memory(), BlockStore::kMinBlocks);
    EXPECT_EQ(volume.take_changed(), unbounded.take_changed());
  }
  ASSERT_GT(volume.size(), 3 * BlockStore::kMinBlocks);
  EXPECT_EQ(volume.lost_blocks(), 0U);
  EXPECT_EQ(differing_blocks(volume, unbounded), 0);
  const TriangleMesh mesh = mesh_all(volume), expected = mesh_all(unbounded);
  EXPECT_EQ(mesh.vertices, expected.vertices);
  EXPECT_EQ(mesh.triangles, expected.triangles);
  for (std::size_t i = 0; i < 8; ++i) volume.unfuse(views[i], maps[i], plain(maps[i], {1, 2, 3}));
  EXPECT_EQ(volume.size(), 0U);
}

TEST(VoxelBlocks, WithoutRoomInTheArchiveTheLongestUnusedAreLost) {
  const Pose T = poses_all_round()[7], T2 = poses_all_round()[30];
  const DepthMap map = sphere_view(T), map2 = sphere_view(T2);
  const auto full = std::make_shared<testing::MemoryArchive>();
  full->room = 0;
  const auto small = std::make_shared<testing::MemoryArchive>();
  VoxelBlocks volumes[] = {VoxelBlocks(kFine, kSmall), VoxelBlocks(kFine, kSmall, full),
                           VoxelBlocks(kFine, {0, 10 * sizeof(VoxelBlock)}, small)};
  for (VoxelBlocks& volume : volumes) {
    const FusedView view = volume.fuse(map, {}, T);
    const std::size_t room = BlockStore::kMinBlocks + (&volume == &volumes[2] ? 10 : 0);
    EXPECT_LE(volume.size(), room);
    EXPECT_GT(volume.lost_blocks(), 0U);
    (void)volume.take_changed();
    const std::vector<BlockIndex> before = volume.indices();
    const FusedView view2 = volume.fuse(map2, {}, T2);
    EXPECT_LE(volume.size(), room);
    const std::vector<BlockIndex> changed = volume.take_changed();
    for (const BlockIndex& b : before) {
      if (!volume.find(b)) {
        EXPECT_TRUE(std::binary_search(changed.begin(), changed.end(), b));
      }
    }
    // What was lost is simply not there to be taken out.
    volume.unfuse(view, map, {});
    volume.unfuse(view2, map2, {});
    EXPECT_EQ(volume.size(), 0U);
  }
  EXPECT_EQ(small->kept.size(), 0U) << "every slot is given back";
}

TEST(VoxelBlocks, WhatCannotBeReadBackIsLostNotAFault) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  VoxelBlocks volume(kFine, kSmall, archive);
  const Pose T = poses_all_round()[7];
  const FusedView view = volume.fuse(sphere_view(T), {}, T);
  const std::size_t blocks = volume.size();
  archive->broken = true;
  for (const BlockIndex& b : volume.indices()) (void)volume.find(b);
  EXPECT_EQ(volume.size() + volume.lost_blocks(), blocks);
  EXPECT_GT(volume.lost_blocks(), 0U);
  volume.unfuse(view, sphere_view(T), {});
  EXPECT_EQ(volume.size(), 0U);
}

TEST(VoxelBlocks, ABlockTakesInSoManyViewsAndGivesThemBack) {
  // The voxels' sums hold kMaxViews observations of full weight; what comes after is left out.
  VoxelBlocks volume(0.4);
  const Pose T = poses_all_round()[3];
  DepthMap map = sphere_view(T);
  std::fill(map.confidence.data(), map.confidence.data() + map.confidence.size(), 1.0F);
  const ColourImage white = plain(map, {255, 255, 255});
  std::vector<FusedView> views;
  for (int i = 0; i < VoxelBlock::kMaxViews + 3; ++i) views.push_back(volume.fuse(map, white, T));
  EXPECT_FALSE(views[VoxelBlock::kMaxViews - 1].blocks.empty());
  EXPECT_TRUE(views.back().blocks.empty());
  VoxelBlocks once(0.4);
  (void)once.fuse(map, white, T);
  for (const BlockIndex& b : once.indices()) {
    for (int i = 0; i < VoxelBlock::kVoxels; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const Voxel one = once.find(b)->voxels[at], all = volume.find(b)->voxels[at];
      ASSERT_EQ(one.sum_weight * VoxelBlock::kMaxViews, all.sum_weight);
      ASSERT_EQ(one.sum_distance * VoxelBlock::kMaxViews, all.sum_distance);
      ASSERT_EQ(one.sum_blue * VoxelBlock::kMaxViews, all.sum_blue);
    }
  }
  for (const FusedView& view : views) volume.unfuse(view, map, white);
  EXPECT_EQ(volume.size(), 0U);
}

TEST(VoxelBlocks, AMapLargerThanMemoryAndArchiveStaysWithinThem) {
  // Voxels that are far too small: nearly every ray needs blocks of its own.
  constexpr VoxelBudget kBudget{1U << 20, 2U << 20};
  const auto archive = std::make_shared<testing::MemoryArchive>();
  VoxelBlocks volume(kVoxel / 20, kBudget, archive);
  const Pose T = poses_all_round()[5];
  const FusedView view = volume.fuse(sphere_view(T), {}, T);
  EXPECT_LE(volume.size() * sizeof(VoxelBlock), kBudget.memory_bytes + kBudget.archive_bytes);
  EXPECT_LE(archive->kept.size() * sizeof(VoxelBlock), kBudget.archive_bytes);
  EXPECT_GT(volume.lost_blocks(), 100U);
  volume.unfuse(view, sphere_view(T), {});
  EXPECT_EQ(volume.size(), 0U);
  EXPECT_TRUE(mesh_all(volume).empty()) << "an empty volume has an empty surface";
}

TEST(VoxelBlocks, AFarCameraAndAnEmptyMapChangeNothing) {
  VoxelBlocks volume(kVoxel);
  DepthMap map = sphere_view(poses_all_round()[0]);
  const Pose far(Eigen::Quaterniond::Identity(), Eigen::Vector3d(1e12, 0, 0));
  EXPECT_TRUE(volume.fuse(map, {}, far).blocks.empty());
  map.depth = map.confidence = FloatImage(160, 120);
  EXPECT_TRUE(volume.fuse(map, {}, map.T_world_camera).blocks.empty());
  EXPECT_EQ(volume.size(), 0U);
  EXPECT_TRUE(volume.take_changed().empty());
}

}  // namespace
}  // namespace corvid
