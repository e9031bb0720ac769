#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "corvid/map.h"
#include "corvid/mesh_stream.h"
#include "corvid/options.h"
#include "corvid/ports.h"
#include "corvid/pose.h"
#include "corvid/stored_depth.h"

namespace corvid {

/// Time spent in one stage or one part of it, over a run.
struct StageMetrics {
  std::string name;  ///< "frontend", "frontend/search", "backend/adjust", ...
  std::uint64_t count = 0;
  double median_ms = 0, p95_ms = 0, p99_ms = 0, total_s = 0;
};

/// Everything that a run leaves behind; what the output folder and the report are written from.
struct RunResult {
  Options options;  ///< as resolved
  std::string device;
  SourceInfo source;
  SourceCounts counts;
  std::vector<PoseEvent> events;  ///< one per frame, as they were published
  Trajectory trajectory;          ///< every frame that has a pose, with all later corrections
  std::vector<int> trajectory_segments;  ///< the map segment of each of its poses
  std::shared_ptr<const MapSnapshot> map;
  PlaceCounts places;
  std::vector<StoredDepth> depth_maps;   ///< at the poses of the final map; load one at a time
  std::vector<MapPlacement> placements;  ///< one per map segment
  /// Set by place_on_earth(): trajectory, map, depth maps and mesh are in metres, east, north, up
  /// of this place. Otherwise they are in map units, in the frame of the first keyframe.
  std::optional<GeodeticPosition> enu_origin;
  TriangleMesh mesh;
  double voxel_size = 0;  ///< [map units; m after place_on_earth()]
  std::vector<StageMetrics> stages;
  double wall_s = 0;
  std::uint64_t peak_memory_bytes = 0;
  bool interrupted = false;        ///< stopped before all was done: a partial result
  std::vector<std::string> notes;  ///< anything the user should know, one sentence each
};

/// Brings trajectory, map, depth maps and mesh from the map's frame into the local frame east,
/// north, up [m], each segment by its placement. Events stay as they were published. A segment
/// whose scale is arbitrary, and the mesh, go with the metric segment of most keyframes.
/// @return false, and nothing is changed, if no segment is metric or it was done before.
bool place_on_earth(RunResult& result);

}  // namespace corvid
