#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <set>
#include <utility>
#include <vector>

#include "corvid/image.h"
#include "corvid/map.h"
#include "corvid/pose.h"
#include "mapping/block_store.h"
#include "mapping/slices.h"
#include "mapping/voxel_block.h"

namespace corvid {

/// What must be known to take a depth map out of the volume again.
struct FusedView {
  Pose T_world_camera;  ///< with which it was fused
  std::vector<std::pair<BlockIndex, std::uint32_t>>
      blocks;  ///< that it was written to, and serials
  bool coloured = false;
};

/// A truncated signed distance function (Curless and Levoy 1996) in hashed blocks of 8x8x8 voxels.
///
/// A voxel at depth z on a ray with the measured depth d gets the signed distance d - z, positive
/// in front of the surface, truncated at kTruncationVoxels. Its weight rises with the confidence
/// of the depth and with the cosine between ray and surface normal, and falls with the square of
/// the depth beyond `kFullWeightVoxels`. Blocks are made where a surface was measured; voxels of
/// blocks that exist already and lie in front of a surface are carved (distance = truncation).
/// A block takes in VoxelBlock::kMaxViews views; what more of them say of it is left out. Blocks
/// that memory does not hold lie in an archive (block_store.h) and come back when a view looks at
/// them: the budget changes no result, unless the archive has no room.
/// Not thread-safe, not even where const. Results do not depend on the order of the hash table.
class VoxelBlocks {
 public:
  static constexpr double kTruncationVoxels = 4;
  static constexpr double kFullWeightVoxels = 96;  ///< depth up to which weight is not reduced
  static constexpr double kCarveWeight = 0.5;      ///< of an observation of free space, relative

  /// @param voxel_size  side of a voxel [map units], > 0.
  /// @param archive     may be null: then blocks beyond the budget are lost, and counted.
  /// @param slice_end   called now and then by fuse() and unfuse().
  explicit VoxelBlocks(double voxel_size, const VoxelBudget& budget = {},
                       std::shared_ptr<Archive> archive = nullptr, const SliceEnd& slice_end = {});

  /// Adds a depth map, seen from `T_world_camera` (not from depth_map.T_world_camera).
  /// An empty depth map changes nothing.
  /// @param colour  of the size of the depth image, or empty.
  [[nodiscard]] FusedView fuse(const DepthMap& depth_map, const ColourImage& colour,
                               const Pose& T_world_camera);
  /// Takes out what fuse() added, exactly; the same depth map and colour must be given. Where the
  /// colour is no longer to be had (empty), the mean colour of what is there is taken out; a colour
  /// that was not put in stays out. Blocks that were lost in the meantime are skipped. Blocks left
  /// without a view that measured a surface in them are removed, also if others saw them as free
  /// space. Without the depth map (empty) nothing can be taken out.
  void unfuse(const FusedView& view, const DepthMap& depth_map, const ColourImage& colour);

  /// Blocks changed, made or removed since the last call, sorted.
  [[nodiscard]] std::vector<BlockIndex> take_changed();
  /// All blocks, sorted.
  [[nodiscard]] std::vector<BlockIndex> indices() const;
  [[nodiscard]] bool contains(const BlockIndex& index) const { return store_.contains(index); }
  /// nullptr if there is no such block. Valid while at most BlockStore::kPointersValid others are
  /// asked for.
  [[nodiscard]] const VoxelBlock* find(const BlockIndex& index) const;
  /// The block, made if need be, marked as changed. For filling a volume by hand.
  [[nodiscard]] VoxelBlock& touch(const BlockIndex& index);

  [[nodiscard]] double voxel_size() const { return voxel_size_; }
  [[nodiscard]] double truncation() const { return kTruncationVoxels * voxel_size_; }
  [[nodiscard]] std::size_t size() const { return store_.size(); }
  [[nodiscard]] std::size_t in_memory() const { return store_.in_memory(); }
  [[nodiscard]] std::uint64_t lost_blocks() const { return store_.lost(); }

 private:
  [[nodiscard]] std::vector<BlockIndex> blocks_on_surface(const DepthMap& depth_map,
                                                          const Pose& T_world_camera) const;
  void note_lost();

  double voxel_size_;
  SliceEnd slice_end_;
  mutable BlockStore store_;  ///< what is in memory follows what is looked at
  std::set<BlockIndex> changed_;
};

}  // namespace corvid
