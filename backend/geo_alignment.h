#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "corvid/position.h"

namespace corvid {

/// A camera centre of the map and the position that was measured there.
struct PlacedPoint {
  Eigen::Vector3d p_map = Eigen::Vector3d::Zero();
  Eigen::Vector3d p_enu_m = Eigen::Vector3d::Zero();
  /// Of the distance between the two: the position's noise, and what the map has drifted.
  Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Identity();
};

struct GeoAlignmentSettings {
  double max_scale_sigma = 0.02;  ///< of the logarithm of the scale; above it the path is too short
  double max_rotation_sigma_rad =
      0.09;                ///< about the worst axis; above it the path is too straight
  std::uint64_t seed = 1;  ///< of RANSAC
};

enum class GeoAlignmentStatus {
  ok,
  too_few,       ///< positions
  too_short,     ///< against the positions' noise: the scale is not known well enough
  too_straight,  ///< the rotation about the line is not known well enough
  inconsistent,  ///< fewer than half of the positions agree with one similarity
};

struct GeoAlignment {
  GeoAlignmentStatus status = GeoAlignmentStatus::too_few;
  std::string reason;  ///< a clause with its figures; empty if ok
  Sim3 T_enu_map;      ///< identity unless ok
  /// Of the right perturbation (rho, phi, sigma); zero unless ok.
  Matrix7d covariance = Matrix7d::Zero();
  std::vector<std::uint8_t> inlier;  ///< one per point; all zero unless ok
  int inliers = 0;
  double rmse_m = 0;        ///< of the inliers
  double error_factor = 0;  ///< their errors in units of what the covariances say
  [[nodiscard]] bool ok() const { return status == GeoAlignmentStatus::ok; }
};

/// The similarity that takes the map to the positions: RANSAC over triples (Umeyama's closed form),
/// then Gauss-Newton with the full covariances over those that agree (Mahalanobis distance, 99.9
/// %).
///
/// The covariance that comes out is enlarged by the residuals' variance factor, if it is above 1,
/// and by their correlation from one point to the next (1 + r) / (1 - r): errors of receivers last
/// for minutes.
///
/// @param points  in the order of time; those that are not finite count as outliers.
/// @param guess  a similarity that may fit, such as the last one.
[[nodiscard]] GeoAlignment align_to_positions(std::span<const PlacedPoint> points,
                                              const GeoAlignmentSettings& settings,
                                              const std::optional<Sim3>& guess = std::nullopt);

}  // namespace corvid
