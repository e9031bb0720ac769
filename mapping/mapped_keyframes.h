#pragma once

#include <cstddef>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "corvid/archive.h"
#include "corvid/map.h"
#include "corvid/stored_depth.h"
#include "mapping/slices.h"
#include "mapping/voxel_blocks.h"

namespace corvid {

/// A keyframe with depth, and what of it is in the voxel map.
struct MappedKeyframe {
  MappedKeyframe(const MapSnapshot& map, const Keyframe& keyframe, const Camera& image_lens,
                 StoredDepth depth_map, double median);

  int segment = 0;
  StoredFramePtr frame;
  Camera lens;          ///< that its image was undistorted with
  StoredDepth depth;    ///< its scale: the one with which it is fused
  double median_depth;  ///< of the scene, at that scale
  /// Depth of the keyframe's landmarks at that scale: its unit of length.
  std::vector<std::pair<LandmarkId, double>> landmark_depths;
  std::optional<FusedView> fused;  ///< empty: not in the voxel map

  std::shared_ptr<const Keyframe> looked_at;  ///< by MappedKeyframes::look(); null: gone
  double motion = 0;                          ///< since it was fused; as then found [map units]
  double growth = 1;                          ///< of its lengths since then
};

/// The keyframes with depth: which of them moved since they were fused, and which of their depth
/// maps stay in memory (the newest).
class MappedKeyframes {
 public:
  /// @param memory_bytes  of depth maps in memory; at least the newest is kept there.
  /// @param archive       for the others; may be null: then all stay in memory. Where it fails, it
  ///                      is tried again 50 keyframes later.
  MappedKeyframes(std::size_t memory_bytes, std::shared_ptr<Archive> archive)
      : memory_bytes_(memory_bytes), archive_(std::move(archive)) {}

  MappedKeyframe& add(KeyframeId id, MappedKeyframe keyframe);
  /// nullptr if it has no depth.
  [[nodiscard]] const MappedKeyframe* find(KeyframeId id) const;
  [[nodiscard]] const std::map<KeyframeId, MappedKeyframe>& all() const { return keyframes_; }
  /// Copies of the depth maps with the poses and the unit of length of `map`, where it has them.
  [[nodiscard]] std::vector<StoredDepth> depth_maps(const MapSnapshot& map) const;
  void drop(KeyframeId id);
  /// Nothing is in the voxel map any more.
  void forget_fused();

  /// Finds out what has moved by more than `least` (points at the median depth, [map units]) or
  /// does not belong where it is: keyframes of `segment` do, others do not. Looks only at keyframes
  /// that are not the same object as before.
  void look(const MapSnapshot& map, int segment, double least, const SliceEnd& slice_end);
  struct Move {
    MappedKeyframe* keyframe = nullptr;
    bool wanted = false;  ///< false: to be taken out; otherwise to looked_at's pose, times growth
  };
  /// The one that moved farthest; it counts as done from here on. Nothing if all are in place.
  [[nodiscard]] std::optional<Move> next_move();

 private:
  void measure(MappedKeyframe& entry, const MapSnapshot& map, bool wanted) const;

  std::size_t memory_bytes_;
  std::shared_ptr<Archive> archive_;
  std::map<KeyframeId, MappedKeyframe> keyframes_;
  std::deque<StoredDepth> in_memory_;  ///< oldest first
  std::size_t in_memory_bytes_ = 0;
  int untried_ = 0;  ///< keyframes to come before the archive is tried again
  std::optional<int> segment_;
  std::set<std::pair<double, KeyframeId>> moved_;  ///< by motion
};

}  // namespace corvid
