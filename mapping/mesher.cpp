#include "mapping/mesher.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <set>
#include <unordered_map>

#include "mapping/marching_cubes.h"

namespace corvid {
namespace {

constexpr int kSide = VoxelBlock::kSide;
/// A crossing stays this far from the ends of its edge, so that no two vertices coincide.
constexpr float kMinFraction = 0.01F;

/// The voxels of a block and of those around it; p in [-8, 15].
class Neighbourhood {
 public:
  Neighbourhood(const VoxelBlocks& volume, const BlockIndex& index, std::uint32_t min_weight)
      : min_weight_(min_weight) {
    for (int i = 0; i < 27; ++i) {
      blocks_[static_cast<std::size_t>(i)] =
          volume.find({index.x + i % 3 - 1, index.y + i / 3 % 3 - 1, index.z + i / 9 - 1});
    }
  }

  /// nullptr if not observed.
  [[nodiscard]] const Voxel* voxel(const Eigen::Vector3i& p) const {
    const auto block = [](int v) { return v < 0 ? 0 : v < kSide ? 1 : 2; };
    const VoxelBlock* in =
        blocks_[static_cast<std::size_t>(block(p.x()) + 3 * block(p.y()) + 9 * block(p.z()))];
    if (!in) return nullptr;
    const Voxel& voxel = in->voxels[static_cast<std::size_t>(
        VoxelBlock::offset(p.x() & (kSide - 1), p.y() & (kSide - 1), p.z() & (kSide - 1)))];
    return voxel.sum_weight >= min_weight_ ? &voxel : nullptr;
  }
  /// @pre it was observed.
  [[nodiscard]] float distance(const Eigen::Vector3i& p) const { return distance(*voxel(p)); }
  /// Central differences, one-sided at the edge of what was observed. @pre p was.
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
  static float distance(const Voxel& voxel) {
    return static_cast<float>(voxel.sum_distance) / static_cast<float>(voxel.sum_weight);
  }
  std::uint32_t min_weight_;
  std::array<const VoxelBlock*, 27> blocks_{};
};

/// Which corners of a block's cells were observed, and which lie inside: bit x of row (y, z).
class CornerBits {
 public:
  explicit CornerBits(const Neighbourhood& grid) {
    for (int z = 0; z <= kSide; ++z) {
      for (int y = 0; y <= kSide; ++y) {
        for (int x = 0; x <= kSide; ++x) {
          const Voxel* voxel = grid.voxel({x, y, z});
          if (!voxel) continue;
          observed_[row(y, z)] |= 1U << x;
          if (voxel->sum_distance < 0) inside_[row(y, z)] |= 1U << x;
        }
      }
    }
  }
  /// Bit x: the cell whose lowest corner is (x, y, z) was observed and the surface runs through it.
  [[nodiscard]] unsigned crossed(int y, int z) const {
    unsigned observed = ~0U, all = ~0U, any = 0;
    for (const std::size_t r : {row(y, z), row(y + 1, z), row(y, z + 1), row(y + 1, z + 1)}) {
      observed &= observed_[r];
      all &= inside_[r];
      any |= inside_[r];
    }
    const auto both = [](unsigned bits) { return bits & bits >> 1; };
    return both(observed) & (any | any >> 1) & ~both(all) & ((1U << kSide) - 1);
  }
  [[nodiscard]] bool inside(const Eigen::Vector3i& corner) const {
    return (inside_[row(corner.y(), corner.z())] >> corner.x() & 1U) != 0;
  }

 private:
  static std::size_t row(int y, int z) { return static_cast<std::size_t>(y + (kSide + 1) * z); }
  std::array<unsigned, (kSide + 1) * (kSide + 1)> observed_{}, inside_{};
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
    const CornerBits corners(grid);
    for (int z = 0; z < kSide; ++z) {
      for (int y = 0; y < kSide; ++y) {
        for (unsigned cells = corners.crossed(y, z); cells != 0; cells &= cells - 1)
          add_cell(grid, corners, index, {std::countr_zero(cells), y, z});
      }
    }
  }

 private:
  static Eigen::Vector3i corner(const Eigen::Vector3i& cell, int c) {
    return cell + Eigen::Vector3i(c & 1, c >> 1 & 1, c >> 2 & 1);
  }

  void add_cell(const Neighbourhood& grid, const CornerBits& corners, const BlockIndex& index,
                const Eigen::Vector3i& cell) {
    unsigned inside = 0;
    for (int c = 0; c < 8; ++c) inside |= (corners.inside(corner(cell, c)) ? 1U : 0U) << c;
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
