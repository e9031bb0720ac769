#pragma once

#include <Eigen/Core>
#include <span>

#include "kernels/corners.h"
#include "kernels/pyramid.h"

namespace corvid {

/// How corners are detected so that there are `most`, the occupied places among them, and that they
/// are spread evenly: three at most in cells of 1.5 times their mean distance, half of it from each
/// other and from what is occupied, templates wholly inside the image. Quality and kappa are the
/// caller's.
/// @param occupied  [px of the image]; must outlive the result
[[nodiscard]] CornerOptions spread_corners(const DeviceImage& image, int most, int template_px,
                                           std::span<const Eigen::Vector2f> occupied);

}  // namespace corvid
