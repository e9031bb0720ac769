#pragma once

#include <cstdint>
#include <memory>
#include <stop_token>
#include <vector>

#include "core/stopwatch.h"
#include "corvid/map.h"
#include "corvid/mesh_stream.h"
#include "corvid/options.h"
#include "corvid/ports.h"
#include "corvid/stored_depth.h"
#include "kernels/device.h"
#include "mapping/slices.h"

namespace corvid {

struct MapperStatistics {
  std::uint64_t depth_maps = 0;        ///< keyframes with depth
  std::uint64_t without_depth = 0;     ///< tried, but too few neighbours or answers
  std::uint64_t skipped = 0;           ///< seen from as near by: the one mapped before, or long ago
  std::uint64_t refusions = 0;         ///< keyframes taken out and put back in at a new pose
  std::uint64_t refits = 0;            ///< times the volume started again with another voxel size
  std::uint64_t blocks = 0;            ///< voxel blocks there are now
  std::uint64_t blocks_in_memory = 0;  ///< of those
  std::uint64_t lost_blocks = 0;       ///< for which neither memory nor the archive had room
  std::uint64_t lost_depth_maps = 0;   ///< that the archive did not give back
  double answered = 0;                 ///< mean share of rays with depth, of the depth maps
};

/// The mapping stage: depth maps of keyframes, fused into a voxel map that follows the poses, and
/// the surface of what changed.
///
/// Synchronous, one owner. The same snapshots in the same order give the same results. Segments of
/// the map have no common frame, so only the segment with the most keyframes is in the voxel map.
/// Device trouble comes as DeviceFault.
class Mapper {
 public:
  /// @param sink  gets the mesh of every changed block; may be null; outlives the mapper.
  /// @param archive  takes what is not in use beyond options.memory_mb; may be null: then depth
  /// maps
  ///        stay in memory, and voxel blocks beyond the budget are lost.
  /// @param slice_end  called every few milliseconds of work on the host. The device's work is in
  ///        Lane::mapping, in launches that are short each. Changes no result.
  /// Fails if an option is wrong or the kernels do not build.
  [[nodiscard]] static Expected<std::unique_ptr<Mapper>> create(
      std::shared_ptr<Device> device, const MappingOptions& options, MeshSink* sink,
      std::shared_ptr<Archive> archive = nullptr, SliceEnd slice_end = {});
  ~Mapper();

  /// Does one unit of work against the newest map: estimates one keyframe's depth and fuses it, or
  /// re-fuses one that moved; false if there was nothing to do. A keyframe's turn comes when two
  /// newer ones of its segment are there to compare it with.
  bool step(const MapSnapshot& map);
  /// All that is left, also the last keyframes, which have no newer neighbours; or what can be done
  /// of it until asked to stop.
  void finish(const MapSnapshot& map, const std::stop_token& stop = {});

  /// The whole surface, vertices on the borders of blocks welded.
  [[nodiscard]] TriangleMesh mesh() const;
  /// By keyframe, where and as large as `map` has them by now, whether fused there or not; those
  /// that it does not have: at the pose of their estimate.
  [[nodiscard]] std::vector<StoredDepth> depth_maps(const MapSnapshot& map = {}) const;
  /// [map units]; 0 until the first keyframes have shown how large the scene is. Without a fixed
  /// options.voxel_size it follows the typical depth of the scene in steps of a factor of 2 or
  /// more.
  [[nodiscard]] double voxel_size() const;
  [[nodiscard]] MapperStatistics statistics() const;
  /// How long the parts of the last step took: "images", "depth", "clean", "unfuse", "fuse",
  /// "mesh".
  [[nodiscard]] const Timings& last_timings() const;

 private:
  struct Impl;
  explicit Mapper(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace corvid
