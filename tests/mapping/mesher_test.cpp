#include "mapping/mesher.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>
#include <set>

#include "mapping/marching_cubes.h"
#include "mapping/mesh_checks.h"

namespace corvid {
namespace {

using testing::topology;

constexpr double kVoxel = 0.05;

/// Writes a signed distance function into all blocks of [-blocks, blocks).
void fill(VoxelBlocks& volume, int blocks,
          const std::function<double(const Eigen::Vector3d&)>& distance) {
  for (int z = -blocks; z < blocks; ++z) {
    for (int y = -blocks; y < blocks; ++y) {
      for (int x = -blocks; x < blocks; ++x) {
        VoxelBlock& block = volume.touch({x, y, z});
        for (int i = 0; i < VoxelBlock::kVoxels; ++i) {
          const Eigen::Vector3d p =
              volume.voxel_size() *
              Eigen::Vector3d(8 * x + (i & 7), 8 * y + (i >> 3 & 7), 8 * z + (i >> 6));
          const double d = std::clamp(distance(p) / volume.truncation(), -1.0, 1.0);
          Voxel& voxel = block.voxels[static_cast<std::size_t>(i)];
          voxel.sum_distance = std::lround(255 * d * Voxel::kDistanceSteps);
          voxel.sum_weight = 255;
          voxel.sum_colour_weight = 15;
          voxel.sum_red = 15 * 200, voxel.sum_green = 15 * 100, voxel.sum_blue = 15 * 50;
        }
      }
    }
  }
}

TEST(MarchingCubes, EveryCaseCoversExactlyTheEdgesThatCross) {
  for (unsigned inside = 0; inside < 256; ++inside) {
    std::set<int> used;
    for (const auto& t : cell_triangles(static_cast<std::uint8_t>(inside))) {
      used.insert(t.begin(), t.end());
    }
    std::set<int> crossing;
    for (std::size_t e = 0; e < 12; ++e) {
      const CellEdge edge = cell_edges()[e];
      const int to = edge.from | 1 << edge.axis;
      if ((inside >> edge.from & 1U) != (inside >> to & 1U)) crossing.insert(static_cast<int>(e));
    }
    EXPECT_EQ(used, crossing) << "case " << inside;
  }
}

TEST(Mesher, SphereIsClosedManifoldOfTheRightRadiusAndLooksOutward) {
  VoxelBlocks volume(kVoxel);
  const double radius = 0.61;
  const Eigen::Vector3d centre(0.013, -0.021, 0.008);
  fill(volume, 3, [&](const Eigen::Vector3d& p) { return (p - centre).norm() - radius; });
  const TriangleMesh mesh = mesh_all(volume);
  ASSERT_GT(mesh.triangles.size(), 1000U);
  EXPECT_TRUE(topology(mesh).closed_manifold());
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Vector3d r = mesh.vertices[i].cast<double>() - centre;
    EXPECT_NEAR(r.norm(), radius, 0.05 * kVoxel);
    EXPECT_GT(r.normalized().dot(mesh.normals[i].cast<double>()), 0.98);
    EXPECT_EQ(mesh.colours[i], (Rgb8{200, 100, 50}));
  }
  EXPECT_NEAR(testing::volume(mesh), 4.0 / 3 * M_PI * std::pow(radius, 3), 0.01);
}

TEST(Mesher, NoiseOfEveryAmbiguityIsClosedAndManifoldAlongEdges) {
  // Random signs meet every one of the 256 cases and every ambiguous face.
  VoxelBlocks volume(kVoxel);
  std::mt19937 random(7);
  std::uniform_real_distribution<double> noise(-1, 1);
  fill(volume, 2, [&](const Eigen::Vector3d& p) {
    const bool border = p.cwiseAbs().maxCoeff() > 14 * kVoxel;
    return (border ? 1.0 : noise(random)) * volume.truncation();
  });
  const testing::Topology t = topology(mesh_all(volume));
  EXPECT_EQ(t.open_edges, 0);
  EXPECT_EQ(t.crowded_edges, 0);
  EXPECT_EQ(t.turned_edges, 0);
  EXPECT_EQ(t.degenerate_faces, 0);
}

TEST(Mesher, BlocksShareTheirBorderVerticesBitForBit) {
  VoxelBlocks volume(kVoxel);
  fill(volume, 3, [](const Eigen::Vector3d& p) { return p.norm() - 0.9; });
  const TriangleMesh whole = mesh_all(volume);
  using Key = std::array<float, 3>;
  const auto key = [](const Eigen::Vector3f& v) { return Key{v.x(), v.y(), v.z()}; };
  std::set<Key> welded, apart;
  for (const auto& v : whole.vertices) welded.insert(key(v));
  EXPECT_EQ(welded.size(), whole.vertices.size());
  std::size_t sum_vertices = 0, sum_triangles = 0;
  for (const BlockIndex& b : blocks_to_remesh(volume.indices())) {
    const TriangleMesh part = mesh_block(volume, b);
    sum_vertices += part.vertices.size();
    sum_triangles += part.triangles.size();
    for (const auto& v : part.vertices) apart.insert(key(v));
  }
  EXPECT_EQ(apart, welded);
  EXPECT_EQ(sum_triangles, whole.triangles.size());
  EXPECT_GT(sum_vertices, whole.vertices.size()) << "the blocks must have borders to share";
}

TEST(Mesher, UnobservedVoxelsLeaveTheSurfaceOpen) {
  VoxelBlocks volume(kVoxel);
  fill(volume, 4, [](const Eigen::Vector3d& p) { return p.norm() - 1.2; });
  for (int i = 0; i < 8; ++i)
    for (Voxel& v : volume.touch({2 + i % 2, i / 2 % 2, i / 4}).voxels) v.sum_weight = 1;
  const testing::Topology t = topology(mesh_all(volume));
  EXPECT_GT(t.open_edges, 0);
  EXPECT_EQ(t.crowded_edges, 0);
  EXPECT_TRUE(mesh_block(volume, {1, 0, 0}).empty());
  EXPECT_TRUE(mesh_block(volume, {100, 0, 0}).empty());
}

TEST(Mesher, FarFromTheOriginNoFaceIsDegenerate) {
  // 1e5 voxels away, float coordinates hold a voxel to about 1/128 only.
  VoxelBlocks volume(1e-3);
  VoxelBlock& block = volume.touch({12500, 12500, 12500});
  for (int i = 0; i < VoxelBlock::kVoxels; ++i) {
    Voxel& voxel = block.voxels[static_cast<std::size_t>(i)];
    voxel.sum_distance = ((i & 7) + (i >> 3 & 7) - 7) * 1000;
    voxel.sum_weight = 255;
  }
  const TriangleMesh mesh = mesh_all(volume);
  ASSERT_FALSE(mesh.empty());
  for (const auto& f : mesh.triangles) {
    EXPECT_NE(mesh.vertices[f[0]], mesh.vertices[f[1]]);
    EXPECT_NE(mesh.vertices[f[1]], mesh.vertices[f[2]]);
    EXPECT_NE(mesh.vertices[f[2]], mesh.vertices[f[0]]);
  }
  EXPECT_EQ(mesh.colours.front(), (Rgb8{128, 128, 128}));
}

TEST(Mesher, ChangedBlocksTakeTheirNeighboursAlong) {
  const auto blocks = blocks_to_remesh({{0, 0, 0}, {1, 0, 0}});
  // Voxel blocks -1 to 2, -1 to 1 and -1 to 1: mesh blocks -1 to 1, -1 to 0 and -1 to 0.
  EXPECT_EQ(blocks.size(), 12U);
  EXPECT_EQ(blocks.front(), (BlockIndex{-1, -1, -1}));
  EXPECT_EQ(blocks.back(), (BlockIndex{1, 0, 0}));
  EXPECT_TRUE(std::is_sorted(blocks.begin(), blocks.end()));
}

}  // namespace
}  // namespace corvid
