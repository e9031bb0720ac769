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

/// F by RANSAC over normalized 8-point samples with an adaptive number of trials and local
/// optimisation (Hartley and Zisserman, Multiple View Geometry, alg. 11.1 and 11.4; Chum, Matas and
/// Kittler, Locally optimized RANSAC, DAGM 2003), then
/// Levenberg-Marquardt over the matrices of rank 2: Sampson distances under Tukey's biweight loss,
/// constant beyond at most three times max_distance_px. Trials are scored
/// by truncated squared distances (MSAC) on a fixed random choice of at most 1,000 correspondences.
///
/// @param x_r, x_t  N >= 8 undistorted pixels of the reference and the target image.
/// @param max_distance_px  Sampson distance of an inlier.
/// @param start  an F to begin with: no trial is made if it fits at least half.
/// @return nothing if fewer than 8 points, points that are not finite, or fewer than 8 inliers.
///         Where points do not tell F (a plane, a pure rotation), one of those that fit.
///         Deterministic in `seed`.
[[nodiscard]] std::optional<EpipolarGeometry> estimate_fundamental(
    std::span<const Eigen::Vector2d> x_r, std::span<const Eigen::Vector2d> x_t,
    double max_distance_px, std::uint64_t seed,
    const std::optional<Eigen::Matrix3d>& start = std::nullopt);

/// The pixel that a pinhole with this camera's K would see: lens distortion removed. NaN-free:
/// nothing where the camera model cannot be inverted or the ray is over 80 degrees off the axis.
[[nodiscard]] std::optional<Eigen::Vector2d> undistort_pixel(const Camera& camera,
                                                             const Eigen::Vector2d& pixel);

}  // namespace corvid
