#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>

#include "corvid/options.h"
#include "frontend/disambiguate/disambiguate.h"
#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// One point in three views, undistorted [px].
struct Triplet {
  Eigen::Vector2d x_r, x_a, x_t;
};

/// Where a match of the reference and an auxiliary view lies in the target, if all three cameras
/// were affine: x_t = offset + linear * (x_r, x_a).
struct AffineTransfer {
  Eigen::Matrix<double, 2, 4> linear = Eigen::Matrix<double, 2, 4>::Zero();
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();
  int inliers = 0;
  double largest_error_px = 0;  ///< tau_MAX, of the inliers
  [[nodiscard]] Eigen::Vector2d operator()(const Eigen::Vector2d& x_r,
                                           const Eigen::Vector2d& x_a) const {
    return offset + linear * Eigen::Vector4d(x_r.x(), x_r.y(), x_a.x(), x_a.y());
  }
};

/// Affine cameras of three views by factorization (SVD of rank 3) of samples of four triplets, by
/// RANSAC (thesis 4.4.9); then over all inliers. The error of a triplet is the distance of x_t from
/// where x_r and x_a meet (least squares in the reference and the auxiliary view). Directions in
/// which points stand out by less than half a pixel in both views, those of a planar scene or of a
/// camera that has not moved, are not used.
///
/// @return nothing if fewer than min_inliers, or fewer than half of all triplets, are within
/// max_px.
[[nodiscard]] std::optional<AffineTransfer> estimate_affine_transfer(
    std::span<const Triplet> triplets, double max_px, int min_inliers, std::uint64_t seed);

/// Affine transfer (thesis 4.4.9): a point of M that has a match in the auxiliary view accepts a
/// candidate by ratio_inequalities() on the distance from where both are transferred to, global =
/// the largest error of an inlier. The triplets are the points of U that have one.
ModuleCounts accept_affine_transfer(MatchSets& sets, const AuxiliaryView& auxiliary,
                                    const DisambiguationOptions& options);

}  // namespace corvid
