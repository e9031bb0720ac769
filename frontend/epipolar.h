#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "corvid/camera.h"

namespace corvid {

/// First-order distance of a correspondence to the epipolar constraint x_t^T F x_r = 0 [px], the
/// square root of (4.24): thresholds on it are distances, not squares, everywhere in Corvid.
[[nodiscard]] double sampson_distance_px(const Eigen::Matrix3d& F, const Eigen::Vector2d& x_r,
                                         const Eigen::Vector2d& x_t);

/// A fundamental matrix with the correspondences that agree.
struct EpipolarGeometry {
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();
  std::vector<bool> inlier;  ///< one per correspondence
  int inliers = 0;
};

/// F by RANSAC over normalized 8-point samples with an adaptive number of trials, then by least
/// squares over the inliers (Hartley and Zisserman, Multiple View Geometry, alg. 11.1 and 11.4).
///
/// @param x_r, x_t  N >= 8 undistorted pixels of the reference and the target image.
/// @param max_distance_px  Sampson distance of an inlier.
/// @return nothing if fewer than 8 points or no sample with 8 inliers. Deterministic in `seed`.
[[nodiscard]] std::optional<EpipolarGeometry> estimate_fundamental(
    std::span<const Eigen::Vector2d> x_r, std::span<const Eigen::Vector2d> x_t,
    double max_distance_px, std::uint64_t seed);

/// The pixel that a pinhole with this camera's K would see: lens distortion removed. NaN-free:
/// nothing where the camera model cannot be inverted or the ray is over 80 degrees off the axis.
[[nodiscard]] std::optional<Eigen::Vector2d> undistort_pixel(const Camera& camera,
                                                             const Eigen::Vector2d& pixel);

}  // namespace corvid
