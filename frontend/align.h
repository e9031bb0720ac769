#pragma once

#include <Eigen/Core>

#include "kernels/ncc.h"
#include "kernels/pyramid.h"

namespace corvid {

/// A similarity between two images: x_target = scale * R(angle) * x_reference + t, full resolution.
struct ImageSimilarity {
  double scale = 1;
  double angle_rad = 0;
  Eigen::Vector2d t_px = Eigen::Vector2d::Zero();
  int votes = 0;  ///< that agree on this similarity
  bool valid = false;

  [[nodiscard]] Eigen::Matrix2d linear() const;
  [[nodiscard]] Eigen::Vector2d operator()(const Eigen::Vector2d& x_reference) const {
    return linear() * x_reference + t_px;
  }
};

/// How two images lie on each other when nothing is known, up to a full turn between them: large
/// templates of the coarse reference, turned in steps, are searched in the whole coarse target;
/// the turn whose matches agree best on one translation wins. This is the full-image search of
/// algorithms.md 3, made independent of rotation.
///
/// @return valid = false if too few templates agree, or if another turn is as good.
[[nodiscard]] ImageSimilarity align_images(NccMatcher& matcher, const DevicePyramid& reference,
                                           const DevicePyramid& target, Lane lane);

}  // namespace corvid
