#include "mapping/crust_blocks.h"

#include "core/check.h"

namespace corvid {

namespace {

Eigen::Vector3i blocks_along(const BitGrid& voxels) {
  return (voxels.size().array() + CrustBlocks::kBlockSide - 1) / CrustBlocks::kBlockSide;
}

/// Calls with the position in the grid of blocks and the lowest voxel of each that is needed.
template <class Call>
void for_each_block(const BitGrid& voxels, Call&& call) {
  const Eigen::Vector3i grid = blocks_along(voxels);
  std::size_t at = 0;
  for (int z = 0; z < grid.z(); ++z) {
    for (int y = 0; y < grid.y(); ++y) {
      for (int x = 0; x < grid.x(); ++x, ++at) {
        const Eigen::Vector3i low = CrustBlocks::kBlockSide * Eigen::Vector3i(x, y, z);
        if (voxels.any_in_block(low)) call(at, low);
      }
    }
  }
}

}  // namespace

std::size_t CrustBlocks::count_places(const BitGrid& voxels) {
  std::size_t blocks = 1;
  for_each_block(voxels, [&](std::size_t, const Eigen::Vector3i&) { ++blocks; });
  return blocks * kBlockVoxels;
}

CrustBlocks::CrustBlocks(const BitGrid& voxels) : grid_(blocks_along(voxels)) {
  block_at_.assign(grid_.cast<std::size_t>().prod(), 0);
  for_each_block(voxels, [&](std::size_t at, const Eigen::Vector3i& low) {
    block_at_[at] = blocks();
    origin_.push_back(low);
  });
  CORVID_CHECK(places() <= kMostPlaces, "the blocks must have fewer than 2^32 voxels");
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
