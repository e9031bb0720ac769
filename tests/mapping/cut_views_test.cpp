#include "mapping/cut_views.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "mapping/cut_mesh.h"
#include "mapping/mesh_checks.h"
#include "scenes/plane_views.h"

namespace corvid {
namespace {

DepthMap depth_of(const testing::PlaneScene& scene, const Camera& camera, const Pose& pose) {
  DepthMap map;
  map.camera = camera;
  map.T_world_camera = pose;
  map.depth = scene.depth(camera, pose);
  map.confidence = FloatImage(camera.width_px, camera.height_px, 1.F);
  return map;
}

/// Views from above, looking straight down (-z), at several places.
std::vector<DepthMap> from_above(const testing::PlaneScene& scene, double height) {
  const Eigen::Quaterniond down(Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitX()));
  std::vector<DepthMap> out;
  for (const double x : {-0.6, 0.0, 0.6}) {
    out.push_back(depth_of(scene, testing::pinhole(140, 140, 100),
                           Pose(down, Eigen::Vector3d(x, 0.1 * x, height))));
  }
  return out;
}

std::vector<CutView> views_of(const std::vector<DepthMap>& maps, const CutVolume& volume) {
  std::vector<CutView> out;
  for (const DepthMap& map : maps) out.emplace_back(map, volume);
  return out;
}

/// The plane z = 0.02 in the middle of a box, which it cuts up to all four sides.
struct Ground {
  CutVolume volume{Eigen::Vector3d(-1.175, -1.175, -1.175), 0.05, {48, 48, 48}};
  testing::PlaneScene scene;
  std::vector<DepthMap> maps;
  std::vector<CutView> views;
  BitGrid crust;
  Ground() {
    scene.planes = {{Eigen::Vector3d(0, 0, 1), 0.02}};
    maps = from_above(scene, 3);
    views = views_of(maps, volume);
    crust = find_points(views, volume, 2).voxels.within_4();
  }
};

TEST(CutViews, CellsAreLabelledByWhatTheViewsSawAlsoAtTheBorders) {
  const Ground ground;
  const CutCells cells = label_cells(ground.views, 0.05, ground.crust, 0.4, 0.95, 2);
  ASSERT_EQ(cells.size, Eigen::Vector3i(24, 24, 24));
  for (int z = 0; z < 48; ++z) {
    const double height = -1.175 + 0.05 * z - 0.02;
    if (std::abs(height) < 0.35) continue;  // the crust and cells cut by its border
    for (const int y : {0, 20, 47}) {
      for (const int x : {0, 23, 47}) {
        EXPECT_FALSE(ground.crust.test({x, y, z}));
        EXPECT_EQ(cells.inside({x, y, z}), height < 0) << x << " " << y << " " << z;
      }
    }
  }
  for (int x = 0; x < 48; ++x) EXPECT_TRUE(ground.crust.test({x, 47 - x, 23})) << x;
}

TEST(CutViews, NoStageGoesOnWhenAskedToStop) {
  const Ground ground;
  std::stop_source source;
  source.request_stop();
  const auto stop = source.get_token();
  const CutCells cells = label_cells(ground.views, 0.05, ground.crust, 0.4, 0.95, 2, stop);
  EXPECT_TRUE(std::all_of(cells.labels.begin(), cells.labels.end(),
                          [](CutLabel label) { return label == CutLabel::unknown; }));
  const auto nothing = [](const auto& values) {
    return std::all_of(values.begin(), values.end(), [](int v) { return v == 0; });
  };
  const CrustBlocks blocks(ground.crust);
  EXPECT_TRUE(nothing(count_votes(ground.views, blocks, 2, stop).sums[0]));
  EXPECT_TRUE(nothing(measure_distances(ground.views, 0.05, ground.crust, blocks, 2, stop).weight));
  TriangleMesh mesh;
  mesh.vertices.emplace_back(0.F, 0.F, 0.02F);
  mesh.normals.emplace_back(0.F, 0.F, 1.F);
  const ColourImage red(140, 140, {250, 0, 0});
  const std::vector<const ColourImage*> colours(3, &red);
  colour_cut(mesh, ground.volume, ground.views, colours, 2, stop);
  EXPECT_EQ(mesh.colours[0], (Rgb8{128, 128, 128}));
  colour_cut(mesh, ground.volume, ground.views, colours, 2);
  EXPECT_EQ(mesh.colours[0], (Rgb8{250, 0, 0}));
}

TEST(CutViews, WhatNobodySawTakesTheNearestLabel) {
  // Only the middle of the ground is seen.
  Ground ground;
  for (DepthMap& map : ground.maps) {
    for (int y = 0; y < 140; ++y) {
      for (int x = 0; x < 140; ++x) {
        if (std::hypot(x - 70, y - 70) > 20) map.depth(x, y) = 0;
      }
    }
  }
  ground.views = views_of(ground.maps, ground.volume);
  ground.crust = find_points(ground.views, ground.volume, 1).voxels.within_4();
  const CutCells cells = label_cells(ground.views, 0.05, ground.crust, 0.4, 0.95, 1);
  for (const int x : {0, 47}) {
    for (const int y : {0, 47}) {
      EXPECT_FALSE(ground.crust.test({x, y, 24}));
      EXPECT_TRUE(cells.inside({x, y, 2}));
      EXPECT_FALSE(cells.inside({x, y, 46}));
    }
  }
}

TEST(CutViews, APointVotesOncePerViewForTheThreeFacesAroundIt) {
  // One ray only; its point lies at (5.3, 7.1, 9.6) voxels.
  const CutVolume volume{Eigen::Vector3d::Zero(), 1, {20, 20, 20}};
  DepthMap map;
  map.camera = testing::pinhole(3, 3, 50);
  map.depth = FloatImage(3, 3);
  map.depth(1, 1) = 30;
  map.confidence = FloatImage(3, 3, 0.5F);
  map.T_world_camera = Pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(5.3, 7.1, -20.4));
  std::vector<DepthMap> maps(3, map);
  map.camera = testing::pinhole(3, 3, 5000);  // a fourth view, all of whose rays end there
  std::fill(map.depth.data(), map.depth.data() + 9, 30.F);
  maps.push_back(map);
  const auto views = views_of(maps, volume);
  const PointVoxels points = find_points(views, volume, 1);
  EXPECT_EQ(points.points, 3U + 9U);
  EXPECT_EQ(points.voxels.count(), 1U);
  EXPECT_TRUE(points.voxels.test({5, 7, 10}));
  const CrustBlocks blocks(points.voxels.within_4());
  EXPECT_EQ(CrustBlocks::count_places(points.voxels.within_4()), blocks.places());
  for (const int threads : {1, 3}) {
    const LinkVotes votes = count_votes(views, blocks, threads);
    const Eigen::Vector3i faces[] = {{5, 7, 10}, {5, 7, 10}, {5, 7, 9}};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      int others = 0;
      for (std::uint32_t p = 0; p < blocks.places(); ++p) {
        if (p == blocks.place(faces[axis])) {
          EXPECT_EQ(votes.sums[axis][p], 4 * kVoteSteps / 2) << axis;
        } else {
          others += votes.sums[axis][p];
        }
      }
      EXPECT_EQ(others, 0) << axis;
    }
  }
}

TEST(CutViews, ViewsVoteHoweverManyThereAre) {
  // Of 600 views the first sees the point, then none for a long time.
  const CutVolume volume{Eigen::Vector3d::Zero(), 1, {20, 20, 20}};
  DepthMap map;
  map.camera = testing::pinhole(3, 3, 50);
  map.depth = map.confidence = FloatImage(3, 3);
  map.T_world_camera = Pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(5.3, 7.1, -20.4));
  std::vector<DepthMap> maps(600, map);
  for (const std::size_t i : {0, 255, 510, 511}) {
    maps[i].depth(1, 1) = 30;
    maps[i].confidence(1, 1) = 0.5F;
  }
  const auto views = views_of(maps, volume);
  const CrustBlocks blocks(find_points(views, volume, 1).voxels.within_4());
  for (const int threads : {1, 3}) {
    const LinkVotes votes = count_votes(views, blocks, threads);
    EXPECT_EQ(votes.sums[0][blocks.place({5, 7, 10})], 4 * kVoteSteps / 2);
  }
}

TEST(CutViews, DistancesAreThoseToThePlane) {
  const Ground ground;
  const CrustBlocks blocks(ground.crust);
  const CutDistances d = measure_distances(ground.views, 0.05, ground.crust, blocks, 2);
  for (int z = 20; z < 28; ++z) {
    const double expected = (-1.175 + 0.05 * z - 0.02) / 0.05;
    if (std::abs(expected) > 3.5) continue;
    const std::uint32_t place = blocks.place({24, 22, z});
    EXPECT_NEAR(d.distance[place] / static_cast<double>(CutDistances::kSteps), expected, 0.05) << z;
    EXPECT_EQ(d.weight[place], 3 * CutDistances::kWeightSteps);
  }
}

TEST(CutMesh, AnyLabelsWithAnyDistancesGiveAClosedSurface) {
  // Random labels meet every case of marching cubes; the distances contradict half of them.
  const CutVolume volume{Eigen::Vector3d(3, -4, 5), 0.1, {19, 17, 70}};
  std::mt19937 random(3);
  BitGrid solid(volume.size), all(volume.size);
  for (int z = 0; z < 70; ++z) {
    for (int y = 0; y < 17; ++y) {
      for (int x = 0; x < 19; ++x) {
        all.set({x, y, z});
        if (random() % 2) solid.set({x, y, z});
      }
    }
  }
  const CrustBlocks blocks(all);
  CutDistances distances;
  for (std::size_t i = 0; i < blocks.places(); ++i) {
    distances.distance.push_back(static_cast<std::int8_t>(static_cast<int>(random() % 249) - 124));
    distances.weight.push_back(static_cast<std::uint8_t>(random() % 3 * 20));
  }
  const TriangleMesh mesh = mesh_cut({volume, solid, blocks, distances}, 5, 0, true, 2);
  const testing::Topology t = testing::topology(mesh);
  EXPECT_GT(mesh.triangles.size(), 20000U);
  EXPECT_EQ(t.open_edges + t.crowded_edges + t.turned_edges + t.degenerate_faces, 0);
  EXPECT_EQ(t.split_vertices, 0);
  for (const auto& n : mesh.normals) EXPECT_NEAR(n.norm(), 1, 1e-5);
}

}  // namespace
}  // namespace corvid
