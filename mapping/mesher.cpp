#include "mapping/mesher.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <unordered_map>

#include "mapping/marching_cubes.h"

namespace corvid {
namespace {

constexpr int kSide = VoxelBlock::kSide;
/// A crossing stays this far from the ends of its edge, so that no two vertices coincide.
constexpr float kMinFraction = 0.01F;

/// The voxels of a block with one more below and two more above on each axis: what its cells and
/// the central differences at their corners need.
class Neighbourhood {
 public:
  static constexpr int kWidth = kSide + 3;

  Neighbourhood(const VoxelBlocks& volume, const BlockIndex& index, std::uint32_t min_weight) {
    std::array<const VoxelBlock*, 27> blocks{};
    for (int i = 0; i < 27; ++i) {
      blocks[static_cast<std::size_t>(i)] =
          volume.find({index.x + i % 3 - 1, index.y + i / 3 % 3 - 1, index.z + i / 9 - 1});
    }
    const auto split = [](int v) { return std::pair{v < 0 ? 0 : v < kSide ? 1 : 2, v & 7}; };
    for (int z = -1; z < kWidth - 1; ++z) {
      for (int y = -1; y < kWidth - 1; ++y) {
        for (int x = -1; x < kWidth - 1; ++x) {
          const auto [bx, vx] = split(x);
          const auto [by, vy] = split(y);
          const auto [bz, vz] = split(z);
          const VoxelBlock* block = blocks[static_cast<std::size_t>(bx + 3 * by + 9 * bz)];
          const Voxel* voxel =
              block ? &block->voxels[static_cast<std::size_t>(VoxelBlock::offset(vx, vy, vz))]
                    : nullptr;
          const std::size_t at = offset(x, y, z);
          voxels_[at] = voxel && voxel->sum_weight >= min_weight ? voxel : nullptr;
          if (voxels_[at]) {
            distances_[at] =
                static_cast<float>(voxel->sum_distance) / static_cast<float>(voxel->sum_weight);
          }
        }
      }
    }
  }

  /// nullptr if not observed.
  [[nodiscard]] const Voxel* voxel(const Eigen::Vector3i& p) const {
    return voxels_[offset(p.x(), p.y(), p.z())];
  }
  [[nodiscard]] float distance(const Eigen::Vector3i& p) const {
    return distances_[offset(p.x(), p.y(), p.z())];
  }
  /// Central differences, one-sided at the edge of what was observed. p in [0, 8].
  [[nodiscard]] Eigen::Vector3f gradient(const Eigen::Vector3i& p) const {
    Eigen::Vector3f g = Eigen::Vector3f::Zero();
    for (int axis = 0; axis < 3; ++axis) {
      Eigen::Vector3i high = p, low = p;
      ++high[axis];
      --low[axis];
      if (!voxel(high)) high = p;
      if (!voxel(low)) low = p;
      const int span = high[axis] - low[axis];
      if (span > 0) g[axis] = (distance(high) - distance(low)) / static_cast<float>(span);
    }
    return g;
  }

 private:
  static std::size_t offset(int x, int y, int z) {
    return static_cast<std::size_t>((x + 1) + kWidth * ((y + 1) + kWidth * (z + 1)));
  }
  std::array<const Voxel*, kWidth * kWidth * kWidth> voxels_;
  std::array<float, kWidth * kWidth * kWidth> distances_;
};

/// Name of a grid edge, the same in every block: where its vertex is.
struct EdgeKey {
  std::array<int, 3> voxel{};
  int axis = 0;
  bool operator==(const EdgeKey&) const = default;
};

struct EdgeKeyHash {
  std::size_t operator()(const EdgeKey& key) const noexcept {
    return BlockIndexHash{}({4 * key.voxel[0] + key.axis, key.voxel[1], key.voxel[2]});
  }
};

Eigen::Vector3f mean_colour(const Voxel& voxel) {
  const auto w = static_cast<float>(voxel.sum_colour_weight);
  return {static_cast<float>(voxel.sum_red) / w, static_cast<float>(voxel.sum_green) / w,
          static_cast<float>(voxel.sum_blue) / w};
}

Rgb8 blend_colours(const Voxel& a, const Voxel& b, float t) {
  if (a.sum_colour_weight == 0 && b.sum_colour_weight == 0) return {128, 128, 128};
  if (a.sum_colour_weight == 0) t = 1;
  if (b.sum_colour_weight == 0) t = 0;
  const Eigen::Vector3f ca = t < 1 ? mean_colour(a) : Eigen::Vector3f::Zero();
  const Eigen::Vector3f cb = t > 0 ? mean_colour(b) : Eigen::Vector3f::Zero();
  const Eigen::Vector3f c = (1 - t) * ca + t * cb;
  const auto byte = [](float v) {
    return static_cast<std::uint8_t>(std::clamp(v + 0.5F, 0.F, 255.F));
  };
  return {byte(c.x()), byte(c.y()), byte(c.z())};
}

/// Appends the surface of one block. `vertex_at` maps a grid edge to its vertex; blocks that share
/// it share their border vertices.
class BlockMesher {
 public:
  BlockMesher(const VoxelBlocks& volume, const MesherOptions& options, TriangleMesh& mesh)
      : volume_(volume), options_(options), mesh_(mesh) {}

  void add(const BlockIndex& index) {
    const Neighbourhood grid(volume_, index, options_.min_weight);
    for (int z = 0; z < kSide; ++z) {
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x) add_cell(grid, index, {x, y, z});
      }
    }
  }

 private:
  static Eigen::Vector3i corner(const Eigen::Vector3i& cell, int c) {
    return cell + Eigen::Vector3i(c & 1, c >> 1 & 1, c >> 2 & 1);
  }

  void add_cell(const Neighbourhood& grid, const BlockIndex& index, const Eigen::Vector3i& cell) {
    unsigned inside = 0;
    for (int c = 0; c < 8; ++c) {
      const Eigen::Vector3i p = corner(cell, c);
      if (!grid.voxel(p)) return;
      if (grid.distance(p) < 0) inside |= 1U << c;
    }
    for (const auto& triangle : cell_triangles(static_cast<std::uint8_t>(inside))) {
      std::array<std::uint32_t, 3> face{};
      for (std::size_t i = 0; i < 3; ++i) {
        const CellEdge edge = cell_edges()[triangle[i]];
        face[i] = vertex(grid, index, corner(cell, edge.from), edge.axis);
      }
      const auto& v = mesh_.vertices;
      // Far from the origin, float coordinates may not tell two crossings apart.
      if (v[face[0]] == v[face[1]] || v[face[1]] == v[face[2]] || v[face[2]] == v[face[0]])
        continue;
      mesh_.triangles.push_back(face);
    }
  }

  std::uint32_t vertex(const Neighbourhood& grid, const BlockIndex& index, const Eigen::Vector3i& p,
                       int axis) {
    const EdgeKey key{{kSide * index.x + p.x(), kSide * index.y + p.y(), kSide * index.z + p.z()},
                      axis};
    const auto [it, is_new] =
        vertex_at_.try_emplace(key, static_cast<std::uint32_t>(mesh_.vertices.size()));
    if (!is_new) return it->second;
    Eigen::Vector3i q = p;
    ++q[axis];
    const float a = grid.distance(p), b = grid.distance(q);
    const float t = std::clamp(a / (a - b), kMinFraction, 1 - kMinFraction);
    Eigen::Vector3d position(key.voxel[0], key.voxel[1], key.voxel[2]);
    position[axis] += t;
    mesh_.vertices.emplace_back((position * volume_.voxel_size()).cast<float>());
    Eigen::Vector3f normal = (1 - t) * grid.gradient(p) + t * grid.gradient(q);
    if (!(normal.squaredNorm() > 0)) normal = Eigen::Vector3f::Unit(axis) * (b > a ? 1.F : -1.F);
    mesh_.normals.push_back(normal.normalized());
    mesh_.colours.push_back(blend_colours(*grid.voxel(p), *grid.voxel(q), t));
    return it->second;
  }

  const VoxelBlocks& volume_;
  const MesherOptions& options_;
  TriangleMesh& mesh_;
  std::unordered_map<EdgeKey, std::uint32_t, EdgeKeyHash> vertex_at_;
};

}  // namespace

TriangleMesh mesh_block(const VoxelBlocks& volume, const BlockIndex& mesh_block,
                        const MesherOptions& options) {
  TriangleMesh mesh;
  BlockMesher mesher(volume, options, mesh);
  for (int i = 0; i < kMeshBlockSide * kMeshBlockSide * kMeshBlockSide; ++i) {
    const BlockIndex index{kMeshBlockSide * mesh_block.x + i % kMeshBlockSide,
                           kMeshBlockSide * mesh_block.y + i / kMeshBlockSide % kMeshBlockSide,
                           kMeshBlockSide * mesh_block.z + i / (kMeshBlockSide * kMeshBlockSide)};
    if (volume.contains(index)) mesher.add(index);
  }
  return mesh;
}

TriangleMesh mesh_all(const VoxelBlocks& volume, const MesherOptions& options) {
  TriangleMesh mesh;
  BlockMesher mesher(volume, options, mesh);
  for (const BlockIndex& index : volume.indices()) mesher.add(index);
  return mesh;
}

std::vector<BlockIndex> blocks_to_remesh(const std::vector<BlockIndex>& changed) {
  const auto mesh_index = [](int block) {
    return block >= 0 ? block / kMeshBlockSide : (block + 1) / kMeshBlockSide - 1;
  };
  std::set<BlockIndex> out;
  for (const BlockIndex& b : changed) {
    for (int i = 0; i < 27; ++i) {
      out.insert({mesh_index(b.x + i % 3 - 1), mesh_index(b.y + i / 3 % 3 - 1),
                  mesh_index(b.z + i / 9 - 1)});
    }
  }
  return {out.begin(), out.end()};
}

}  // namespace corvid
