#include "mapping/crust_blocks.h"

#include "core/check.h"

namespace corvid {

CrustBlocks::CrustBlocks(const BitGrid& voxels)
    : grid_((voxels.size().array() + kBlockSide - 1) / kBlockSide) {
  block_at_.assign(grid_.cast<std::size_t>().prod(), 0);
  std::size_t at = 0;
  for (int z = 0; z < grid_.z(); ++z) {
    for (int y = 0; y < grid_.y(); ++y) {
      for (int x = 0; x < grid_.x(); ++x, ++at) {
        const Eigen::Vector3i low = kBlockSide * Eigen::Vector3i(x, y, z);
        if (!voxels.any_in_block(low)) continue;
        block_at_[at] = blocks();
        origin_.push_back(low);
      }
    }
  }
  CORVID_CHECK(places() <= UINT32_MAX, "the blocks must have fewer than 2^32 voxels");
  neighbours_.resize(origin_.size());
  for (std::uint32_t b = 1; b < blocks(); ++b) {
    for (int d = 0; d < 6; ++d) {
      Eigen::Vector3i p = origin_[b];
      p[d >> 1] += d & 1 ? -kBlockSide : kBlockSide;
      neighbours_[b][static_cast<std::size_t>(d)] = place(p) / kBlockVoxels;
    }
  }
}

std::uint32_t CrustBlocks::place(const Eigen::Vector3i& voxel) const {
  const Eigen::Vector3i b(voxel.x() >> 3, voxel.y() >> 3, voxel.z() >> 3);
  if ((b.array() < 0).any() || (b.array() >= grid_.array()).any()) return 0;
  const Eigen::Matrix<std::size_t, 3, 1> at = b.cast<std::size_t>();
  const Eigen::Matrix<std::size_t, 3, 1> grid = grid_.cast<std::size_t>();
  return block_at_[at.x() + grid.x() * (at.y() + grid.y() * at.z())] * kBlockVoxels +
         static_cast<std::uint32_t>((voxel.x() & 7) | (voxel.y() & 7) << 3 | (voxel.z() & 7) << 6);
}

Eigen::Vector3i CrustBlocks::voxel(std::uint32_t place) const {
  const int local = static_cast<int>(place & (kBlockVoxels - 1));
  return origin_[place / kBlockVoxels] + Eigen::Vector3i(local & 7, local >> 3 & 7, local >> 6);
}

}  // namespace corvid
