#pragma once

#include <Eigen/Core>
#include <optional>
#include <utility>
#include <vector>

#include "corvid/camera.h"

namespace corvid {

/// A search window in the camera's own image: candidates are centre +- radius [px].
struct SearchWindow {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius_x_px = 0, radius_y_px = 0;
};

/// The part of an epipolar line (undistorted px) that can be seen in the image, widened by
/// border_px; nothing if it passes by or is no line.
[[nodiscard]] std::optional<std::pair<Eigen::Vector2d, Eigen::Vector2d>> clip_line(
    const Eigen::Vector3d& line, const Camera& camera, double border_px);

/// Windows that cover the strip around a segment of an epipolar line, in pieces, so that a slanted
/// one needs little more area than a level one.
///
/// The images stay as they are: no rectification, which resamples, bends with distorted lenses and
/// breaks where the epipole lies inside an image (algorithms.md 3;
/// docs/decisions/pair-matching.md).
/// @param from, to  ends, undistorted [px].
/// @param half_height_px  to either side of the line.
/// @param piece_px  length of a piece.
[[nodiscard]] std::vector<SearchWindow> strip_windows(const Camera& camera,
                                                      const Eigen::Vector2d& from,
                                                      const Eigen::Vector2d& to,
                                                      double half_height_px, double piece_px);

}  // namespace corvid
