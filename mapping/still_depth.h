#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "corvid/error.h"
#include "corvid/map.h"
#include "corvid/mesh_stream.h"
#include "kernels/device.h"
#include "mapping/ray_grid.h"

namespace corvid {

/// A photograph with its known pose.
struct StillView {
  FramePtr frame;
  Pose T_world_camera;
};

struct StillDepthOptions {
  int neighbours = 4;  ///< M, views compared with each (thesis 6.4)
  int scale = 1;       ///< one ray per n x n pixels
  /// z in camera coordinates [map units]; if absent it is looked for around the point that the
  /// cameras look at.
  std::optional<DepthInterval> interval;
};

/// What became of one view.
struct StillDepth {
  DepthMap map;                 ///< keyframe: the view's index; without pixels if there is none
  int neighbours = 0;           ///< it was compared with
  int samples = 0;              ///< along a ray
  DepthInterval interval;       ///< that was searched
  double answered = 0;          ///< share of the rays
  Image<std::uint8_t> seen_by;  ///< views that agree on an answer, its own included; 0: no answer
  std::string refusal;          ///< why there is no map; empty if there is one
};

/// The point nearest to all optical axes [map units, world]; nothing if the axes are nearly
/// parallel or it does not lie in front of most cameras.
[[nodiscard]] std::optional<Eigen::Vector3d> point_looked_at(std::span<const Pose> T_world_camera);

/// Depth maps of calibrated stills with known poses, each against its neighbours, then against each
/// other's maps.
/// @param progress  called before each view with its index; returns false to stop.
/// Errors: invalid_argument: fewer than 3 views, cameras that differ, views from one place, no
/// point that they look at (and no interval); device.
[[nodiscard]] Expected<std::vector<StillDepth>> depth_of_stills(
    const std::shared_ptr<Device>& device, std::span<const StillView> views,
    const StillDepthOptions& options, const std::function<bool(std::size_t)>& progress = {});

/// The points on which at least `min_views` views agree, of every view's map, with the frames'
/// colours.
[[nodiscard]] TriangleMesh agreed_points(std::span<const StillView> views,
                                         std::span<const StillDepth> depths, int min_views = 3);

}  // namespace corvid
