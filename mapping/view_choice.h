#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "corvid/map.h"

namespace corvid {

/// Where a keyframe's scene lies, from the landmarks that it sees.
struct SceneDepth {
  double near = 0, median = 0, far = 0;  ///< z in camera coordinates [map units]
  int landmarks = 0;                     ///< in front of the camera
};

/// @param percentile  share of landmarks cut off at either end, in [0, 0.5).
/// @return nothing if fewer than 8 landmarks lie in front of the camera.
[[nodiscard]] std::optional<SceneDepth> scene_depth(const MapSnapshot& map,
                                                    const Keyframe& keyframe,
                                                    double percentile = 0.005);

/// A view to compare a keyframe with.
struct Neighbour {
  std::size_t index = 0;  ///< into map.keyframes
  double angle_rad = 0;   ///< median triangulation angle at the shared landmarks
  double overlap = 0;     ///< share of the keyframe's landmarks that this one sees, too
};

struct ViewChoiceOptions {
  int neighbours = 4;             ///< M (thesis 6.4)
  int min_shared = 12;            ///< landmarks seen by both
  double min_angle_rad = 0.004;   ///< below, a view tells nothing of depth
  double best_angle_rad = 0.10;   ///< about 6 degrees
  double max_angle_rad = 0.6;     ///< above, the views look too different
  double focal_px = 500;          ///< of the images compared
  double inverse_depth_step = 0;  ///< of the sweep [1/map units]; 0: no preference
};

/// The M views to compare map.keyframes[reference] with: of its segment, best by overlap and by
/// triangulation angle (after Goesele et al. 2007 and Schoenberger et al. 2016), from before and
/// after the keyframe alike where there are both. A view in which one step of the sweep moves a
/// pixel at the median depth's near side by much more than one pixel counts less.
/// Sorted by index; empty if nothing overlaps.
[[nodiscard]] std::vector<Neighbour> choose_neighbours(const MapSnapshot& map,
                                                       std::size_t reference,
                                                       const ViewChoiceOptions& options);

/// The same where there are no landmarks, but it is known where the scene is: of the views that see
/// the point in their image, by the angle between their rays to it. `overlap` is 1.
[[nodiscard]] std::vector<Neighbour> choose_neighbours(std::span<const Pose> T_world_camera,
                                                       const Camera& camera, std::size_t reference,
                                                       const Eigen::Vector3d& p_scene,
                                                       const ViewChoiceOptions& options);

}  // namespace corvid
