#include "mapping/still_cut.h"

#include <optional>
#include <vector>

#include "kernels/warp.h"

namespace corvid {
namespace {

DepthMap agreed_depth(const StillDepth& depth, int min_views) {
  DepthMap map = depth.map;
  for (std::size_t i = 0; i < map.depth.size(); ++i) {
    if (depth.seen_by.data()[i] < min_views) map.depth.data()[i] = 0;
  }
  return map;
}

}  // namespace

Expected<SurfaceCut> cut_stills(std::span<const StillView> views,
                                std::span<const StillDepth> depths,
                                const SurfaceCutOptions& options, const SurfaceCutControl& control,
                                int min_views) {
  std::vector<DepthMap> maps;
  std::vector<ColourImage> colours;
  std::optional<WarpMap> to_map;
  for (std::size_t i = 0; i < depths.size(); ++i) {
    if (!depths[i].refusal.empty()) continue;
    maps.push_back(agreed_depth(depths[i], min_views));
    const Camera& lens = *views[i].frame->camera;  // the same of all
    if (!to_map) {
      to_map = WarpMap::between(lens, maps.back().camera, Eigen::Matrix3d::Identity());
    }
    colours.push_back(remap_colours(*views[i].frame, lens, *to_map));
  }
  std::vector<SurfaceCutView> seen;
  for (std::size_t i = 0; i < maps.size(); ++i) {
    seen.push_back({&maps[i], colours[i].empty() ? nullptr : &colours[i]});
  }
  return cut_surface(seen, options, control);
}

}  // namespace corvid
