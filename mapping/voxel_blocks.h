#pragma once

#include <Eigen/Core>
#include <array>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <set>
#include <unordered_map>
#include <utility>
#include <vector>

#include "corvid/image.h"
#include "corvid/map.h"
#include "corvid/pose.h"
#include "mapping/slices.h"

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
/// weight times colour. Integers, so that taking a depth map out again restores them exactly.
/// A voxel holds at least 32,000 observations of full weight.
struct Voxel {
  static constexpr int kDistanceSteps = 256;  ///< fixed-point steps per truncation distance

  std::int32_t sum_distance = 0;  ///< of weight * distance [truncation / kDistanceSteps]
  std::uint32_t sum_weight = 0;
  std::uint32_t sum_colour_weight = 0;  ///< only observations near the surface have a colour
  std::array<std::uint32_t, 3> sum_colour{};
  bool operator==(const Voxel&) const = default;
};

struct VoxelBlock {
  static constexpr int kSide = 8;
  static constexpr int kVoxels = kSide * kSide * kSide;
  std::uint64_t serial = 0;  ///< differs for every block that was ever made
  int surface_views = 0;     ///< views that measured a surface in it; a block without is removed
  std::array<Voxel, kVoxels> voxels{};

  [[nodiscard]] static constexpr int offset(int x, int y, int z) {
    return x + kSide * (y + kSide * z);
  }
};

/// What must be known to take a depth map out of the volume again.
struct FusedView {
  Pose T_world_camera;  ///< with which it was fused
  std::vector<std::pair<BlockIndex, std::uint64_t>>
      blocks;  ///< that it was written to, and serials
};

/// A truncated signed distance function (Curless and Levoy 1996) in hashed blocks of 8x8x8 voxels.
///
/// A voxel at depth z on a ray with the measured depth d gets the signed distance d - z, positive
/// in front of the surface, truncated at kTruncationVoxels. Its weight rises with the confidence
/// of the depth and with the cosine between ray and surface normal, and falls with the square of
/// the depth beyond `kFullWeightVoxels`. Blocks are made where a surface was measured; voxels of
/// blocks that exist already and lie in front of a surface are carved (distance = truncation).
/// Not thread-safe. Results do not depend on the order of the hash table.
class VoxelBlocks {
 public:
  static constexpr double kTruncationVoxels = 4;
  static constexpr double kFullWeightVoxels = 96;  ///< depth up to which weight is not reduced
  static constexpr int kMaxWeight = 255;           ///< of one observation
  static constexpr double kCarveWeight = 0.5;      ///< of an observation of free space, relative

  /// @param voxel_size  side of a voxel [map units], > 0.
  /// @param max_blocks  budget (about 12 KB each); never exceeded.
  /// @param slice_end   called now and then by fuse() and unfuse().
  VoxelBlocks(double voxel_size, int max_blocks, SliceEnd slice_end = {});

  /// Adds a depth map, seen from `T_world_camera` (not from depth_map.T_world_camera). Where the
  /// budget is spent, the blocks farthest from `p_keep` (the newest camera) are dropped or not
  /// made, and counted.
  /// @param colour  of the size of the depth image, or empty.
  [[nodiscard]] FusedView fuse(const DepthMap& depth_map, const ColourImage& colour,
                               const Pose& T_world_camera, const Eigen::Vector3d& p_keep);
  /// Takes out what fuse() added, exactly; the same depth map and colour must be given. Blocks that
  /// were dropped in the meantime are skipped. Blocks left without a view that measured a surface
  /// in them are removed, also if others saw them as free space.
  void unfuse(const FusedView& view, const DepthMap& depth_map, const ColourImage& colour);

  /// Blocks changed, made or removed since the last call, sorted.
  [[nodiscard]] std::vector<BlockIndex> take_changed();
  /// All blocks, sorted.
  [[nodiscard]] std::vector<BlockIndex> indices() const;
  /// nullptr if there is no such block.
  [[nodiscard]] const VoxelBlock* find(const BlockIndex& index) const;
  /// The block, made if need be, marked as changed. For filling a volume by hand.
  [[nodiscard]] VoxelBlock& touch(const BlockIndex& index);

  [[nodiscard]] double voxel_size() const { return voxel_size_; }
  [[nodiscard]] double truncation() const { return kTruncationVoxels * voxel_size_; }
  [[nodiscard]] std::size_t size() const { return blocks_.size(); }
  [[nodiscard]] std::uint64_t dropped_blocks() const { return dropped_; }

 private:
  [[nodiscard]] std::vector<BlockIndex> blocks_on_surface(const DepthMap& depth_map,
                                                          const Pose& T_world_camera) const;
  [[nodiscard]] bool may_be_seen(const BlockIndex& index, const Camera& camera,
                                 const Pose& T_camera_world, double deepest) const;
  void make_blocks(const std::vector<BlockIndex>& wanted, const Eigen::Vector3d& p_keep);

  double voxel_size_;
  std::size_t max_blocks_;
  SliceEnd slice_end_;
  std::uint64_t next_serial_ = 1;
  std::uint64_t dropped_ = 0;
  std::unordered_map<BlockIndex, std::unique_ptr<VoxelBlock>, BlockIndexHash> blocks_;
  std::set<BlockIndex> changed_;
};

}  // namespace corvid
