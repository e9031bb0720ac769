#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "corvid/frame.h"
#include "corvid/image.h"
#include "corvid/map.h"
#include "corvid/pose.h"

namespace corvid {

/// An image with its true pose and, where it is known, the true depth.
struct TrueView {
  FramePtr frame;
  Pose T_world_camera;
  FloatImage depth;  ///< z in camera coordinates [m], of the frame's size; 0: not known
};

/// Views of one scene, in the order of a flight past it.
struct MappingScene {
  std::string name;
  std::vector<TrueView> views;  ///< all of one camera
};

/// What a perfect backend would publish after these views: their poses, and landmarks on the true
/// surface, each seen by the views whose true depth agrees within 2 %.
/// @pre every view has depth.
[[nodiscard]] MapSnapshot true_map(const MappingScene& scene, int landmarks_per_view = 200);

/// Depth against truth, over all pixels that have both. Absent: there are none.
struct DepthScore {
  std::optional<double> answered;        ///< of the pixels with truth
  std::optional<double> within_1;        ///< of the answers: relative error below 1 %
  std::optional<double> within_2;        ///< below 2 %
  std::optional<double> median_error_m;  ///< absolute
  int maps = 0;
};

/// Depth maps of scaled, undistorted cameras are compared with the truth along the same ray.
[[nodiscard]] DepthScore score_depth(const MappingScene& scene,
                                     const std::vector<std::shared_ptr<const DepthMap>>& maps);

}  // namespace corvid
