#include "apps/run_cut.h"

#include <algorithm>
#include <map>
#include <utility>
#include <vector>

#include "core/log.h"
#include "kernels/warp.h"

namespace corvid {
namespace {

constexpr const char* kWhere = "surface cut";

/// A depth map and the keyframe that it belongs to.
struct Seen {
  DepthMap depth;
  const Keyframe* keyframe;
};

/// The depth maps of the segment that has most of them.
std::vector<Seen> largest_segment(const RunResult& result) {
  std::map<KeyframeId, const Keyframe*> keyframes;
  if (result.map) {
    for (const auto& keyframe : result.map->keyframes) keyframes[keyframe->id] = keyframe.get();
  }
  std::map<int, std::vector<const StoredDepth*>> segments;
  for (const StoredDepth& depth : result.depth_maps) {
    const auto it = keyframes.find(depth.keyframe);
    if (it == keyframes.end()) continue;  // it left the map, and nobody knows where it stands
    segments[it->second->segment].push_back(&depth);
  }
  if (segments.empty()) return {};
  const auto& largest =
      std::max_element(segments.begin(), segments.end(), [](const auto& a, const auto& b) {
        return a.second.size() < b.second.size();
      })->second;
  std::vector<Seen> seen;
  for (const StoredDepth* stored : largest) {
    DepthMap depth = stored->load();
    if (!depth.depth.empty()) seen.push_back({std::move(depth), keyframes[stored->keyframe]});
  }
  return seen;
}

/// What the keyframe's camera saw, on the pinhole of its depth map; empty without an image.
ColourImage colours_of(const Seen& seen, const Camera& lens) {
  if (!seen.keyframe->frame) return {};
  return remap_colours(*seen.keyframe->frame->load(), lens,
                       WarpMap::between(lens, seen.depth.camera, Eigen::Matrix3d::Identity()));
}

}  // namespace

Expected<SurfaceCut> cut_run(const RunResult& result, const std::stop_token& stop) {
  if (stop.stop_requested()) return fail(ErrorCode::interrupted, "asked to stop", kWhere);
  const std::vector<Seen> seen = largest_segment(result);
  if (seen.empty()) {
    return fail(ErrorCode::not_found, "the run has no depth map", kWhere,
                "it saw too little to map");
  }
  std::vector<ColourImage> colours;
  std::vector<SurfaceCutView> views;
  for (const Seen& s : seen) {
    colours.push_back(result.map->camera ? colours_of(s, *result.map->camera) : ColourImage());
  }
  for (std::size_t i = 0; i < seen.size(); ++i) {
    views.push_back({&seen[i].depth, colours[i].empty() ? nullptr : &colours[i]});
  }
  const MappingOptions& asked = result.options.mapping;
  SurfaceCutOptions options;
  options.voxel_size = asked.cut_voxel_size > 0 ? asked.cut_voxel_size : result.voxel_size;
  options.decay = asked.cut_decay;
  options.ballooning = asked.cut_ballooning;
  options.closed = asked.cut_closed;
  options.max_bytes = static_cast<std::size_t>(asked.cut_max_mb) * 1000000;
  options.coarsen = true;
  options.threads = result.options.threads;
  log().info("cutting the surface from {} depth maps", views.size());
  auto cut = cut_surface(views, options, {stop, [](std::string_view stage) {
                                            log().info("cutting the surface: {}", stage);
                                          }});
  if (!cut) return cut;
  if (cut->mesh.empty()) {
    return fail(ErrorCode::not_found, "no voxel is inside", kWhere,
                "a larger mapping.cut_ballooning fills more");
  }
  const SurfaceCutStatistics& s = cut->statistics;
  log().info(
      "the cut: {} voxels of {:.4g}, {} near points; graph {:.2f} s, maximum flow {:.2f} s, mesh "
      "{:.2f} s",
      s.voxels, cut->voxel_size, s.crust_voxels, s.graph_s, s.maxflow_s, s.mesh_s);
  if (options.voxel_size > 0 && cut->voxel_size > 1.001 * options.voxel_size) {
    log().warn("the cut has voxels of {:.4g} instead of {:.4g}: mapping.cut_max_mb is {}",
               cut->voxel_size, options.voxel_size, asked.cut_max_mb);
  }
  return cut;
}

}  // namespace corvid
