#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapping/bit_grid.h"

namespace corvid {

/// Places for the voxels of a thin part of a box: blocks of 8x8x8, made where a voxel is set. A
/// voxel's place is block * 512 + x + 8 y + 64 z (inside the block); block 0 stands for "none", so
/// places below kNone are in no block. Arrays over places hold blocks() * kBlockVoxels elements.
class CrustBlocks {
 public:
  static constexpr int kBlockSide = 8;
  static constexpr std::uint32_t kBlockVoxels = 512;
  static constexpr std::uint32_t kNone = kBlockVoxels;

  static constexpr std::size_t kMostPlaces = UINT32_MAX;
  /// places() of the blocks of a box of voxels.
  [[nodiscard]] static std::size_t count_places(const BitGrid& voxels);

  /// @pre count_places(voxels) <= kMostPlaces.
  explicit CrustBlocks(const BitGrid& voxels);
  CrustBlocks() = default;

  /// With block 0.
  [[nodiscard]] std::uint32_t blocks() const { return static_cast<std::uint32_t>(origin_.size()); }
  [[nodiscard]] std::size_t places() const { return origin_.size() * kBlockVoxels; }
  /// The lowest voxel of a block. @pre 0 < block < blocks().
  [[nodiscard]] const Eigen::Vector3i& origin(std::uint32_t block) const { return origin_[block]; }
  /// Any voxel, also outside of the box.
  [[nodiscard]] std::uint32_t place(const Eigen::Vector3i& voxel) const;
  /// @pre place >= kNone.
  [[nodiscard]] Eigen::Vector3i voxel(std::uint32_t place) const;
  /// The voxel next to one: direction 0 is +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z.
  [[nodiscard]] std::uint32_t neighbour(std::uint32_t place, int direction) const {
    const std::uint32_t local = place & (kBlockVoxels - 1);
    const std::uint32_t shift = 3 * (static_cast<std::uint32_t>(direction) >> 1);
    const std::uint32_t at = local >> shift & 7U, step = 1U << shift;
    if (direction & 1) {
      if (at > 0) return place - step;
      return block_beside(place, direction) * kBlockVoxels + local + 7 * step;
    }
    if (at < 7) return place + step;
    return block_beside(place, direction) * kBlockVoxels + local - 7 * step;
  }

 private:
  [[nodiscard]] std::uint32_t block_beside(std::uint32_t place, int direction) const {
    return neighbours_[place / kBlockVoxels][static_cast<std::size_t>(direction)];
  }
  Eigen::Vector3i grid_ = Eigen::Vector3i::Zero();  ///< blocks along each axis of the box
  std::vector<std::uint32_t> block_at_;             ///< by position in that grid; 0: none
  std::vector<Eigen::Vector3i> origin_{Eigen::Vector3i::Zero()};
  std::vector<std::array<std::uint32_t, 6>> neighbours_{{}};  ///< by direction
};

}  // namespace corvid
