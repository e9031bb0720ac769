#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>

#include <array>

namespace corvid {

/// Position of a block in the voxel grid. Block (i,j,k) holds the voxels whose grid coordinates
/// lie in [8i, 8i+8) and so on; the voxel (0,0,0) is centred on the world's origin.
struct BlockIndex {
  int x = 0, y = 0, z = 0;
  auto operator<=>(const BlockIndex&) const = default;
};

struct BlockIndexHash {
  std::size_t operator()(const BlockIndex& b) const noexcept {
    const auto mix = [](std::uint64_t h, int v) {
      h = (h ^ static_cast<std::uint32_t>(v)) * 0x9E3779B97F4A7C15ULL;
      return h ^ (h >> 29);
    };
    return static_cast<std::size_t>(mix(mix(mix(0, b.x), b.y), b.z));
  }
};

/// Sums over the depth maps that were fused: of weight, of weight times signed distance and of
/// weight times colour. Integers, so that taking a depth map out again restores them exactly. Their
/// widths hold VoxelBlock::kMaxViews observations of full weight.
struct Voxel {
  static constexpr int kDistanceSteps = 256;   ///< fixed-point steps per truncation distance
  static constexpr int kMaxWeight = 255;       ///< of one observation
  static constexpr int kMaxColourWeight = 15;  ///< of one observation

  std::int64_t sum_distance : 28 = 0;        ///< of weight * distance [truncation / kDistanceSteps]
  std::uint64_t sum_colour_weight : 14 = 0;  ///< only observations near the surface have a colour
  std::uint64_t sum_red : 22 = 0;
  std::uint64_t sum_weight : 18 = 0;
  std::uint64_t sum_green : 22 = 0;
  std::uint64_t sum_blue : 22 = 0;
  bool operator==(const Voxel&) const = default;
};
static_assert(sizeof(Voxel) == 16);

struct VoxelBlock {
  static constexpr int kSide = 8;
  static constexpr int kVoxels = kSide * kSide * kSide;
  static constexpr int kMaxViews = 1024;  ///< that are written to one block
  int views = 0;                          ///< that are written to it
  int surface_views = 0;  ///< of those, that measured a surface in it; a block without is removed
  std::array<Voxel, kVoxels> voxels{};

  [[nodiscard]] static constexpr int offset(int x, int y, int z) {
    return x + kSide * (y + kSide * z);
  }
};

}  // namespace corvid
