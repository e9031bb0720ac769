#pragma once

#include <optional>
#include <span>
#include <vector>

#include "bench/matching/pair_side.h"
#include "corvid/ports.h"
#include "corvid/pose.h"

namespace corvid {

/// What a run of images and their matches give in three dimensions.
struct Reconstruction {
  int images = 0;        ///< with a pose
  int points = 0;        ///< 3-d, with all errors within 3 px, in front of the cameras
  int point_images = 0;  ///< sum over the points of the images that see them
  int conflicts = 0;     ///< tracks left out for two different points in one image
  /// Sum over the pair correspondences of these points of |x_R - x^_R|^2 + |x_T - x^_T|^2, with
  /// adjusted cameras and points [px^2]; over `correspondences` it is (3.15).
  double squared_error_px2 = 0;
  int correspondences = 0;
  [[nodiscard]] std::optional<double> mse_px2() const {
    return correspondences > 0 ? std::optional(squared_error_px2 / correspondences) : std::nullopt;
  }
};

/// Tracks from pairwise matches, and one bundle adjustment over them; the same for either side.
///
/// Matches are chained by the names of their points. A track with two points over 1 px apart in
/// one image is left out. Poses start from T_world_camera, or, if one is missing, from the
/// backend fed with the tracks. Points are triangulated (rays at least 1 mrad apart), all is
/// adjusted (Huber 1 px, equal weights, until the cost stands still), points are triangulated anew
/// from the adjusted cameras, those with an error over 3 px leave, and all is adjusted again.
/// @param images  of one camera.
/// @param T_world_camera  one per image, where it is known.
/// @param origin  of the intrinsics: those without a calibration are estimated, too.
/// Deterministic.
[[nodiscard]] Reconstruction reconstruct(std::span<const FramePtr> images,
                                         std::span<const std::optional<Pose>> T_world_camera,
                                         std::span<const MatchedPair> pairs,
                                         IntrinsicsOrigin origin);

}  // namespace corvid
