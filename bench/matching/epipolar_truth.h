#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "bench/matching/pair_side.h"
#include "corvid/camera.h"
#include "corvid/pose.h"

namespace corvid {

/// Matches further from their true epipolar line than this are wrong.
inline constexpr double kWrong_px = 3;

/// F of two true poses: x_t^T F x_r = 0 on undistorted pixels (undistort_pixel()). Nothing if they
/// are less than 1 cm apart: recorded truths do not know the direction of so small a motion.
[[nodiscard]] std::optional<Eigen::Matrix3d> true_fundamental(const Camera& camera,
                                                              const Pose& T_world_r,
                                                              const Pose& T_world_t);

/// Distance of each undistorted x_t to the line F x_r [px]; matches whose pixels have no ray, or
/// whose x_r is the epipole itself, are left out.
[[nodiscard]] std::vector<double> epipolar_distances_px(const Camera& camera,
                                                        const Eigen::Matrix3d& F,
                                                        std::span<const Correspondence> matches);

}  // namespace corvid
