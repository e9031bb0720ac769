#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "corvid/camera.h"
#include "corvid/pose.h"

namespace corvid {

/// A known point and where it is seen.
struct PointView {
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double sigma_px = 1;
};

struct ResectSettings {
  double max_error_px = 2.5;
  double huber_px = 1.0;
  int min_inliers = 20;
  std::uint64_t seed = 1;
  int max_trials = 400;  ///< of the P3P RANSAC
};

struct Resection {
  bool ok = false;                         ///< at least min_inliers points agree
  Pose T_world_camera;                     ///< meaningful if ok
  Matrix6d covariance = Matrix6d::Zero();  ///< of the right perturbation, points taken as exact
  std::vector<std::uint8_t> inlier;        ///< one per point
  int inliers = 0;
  double mse_px2 = 0;        ///< mean squared reprojection error of the inliers
  bool from_ransac = false;  ///< the prediction was not good enough
};

/// Pose of a camera from known points (algorithms.md, 6).
///
/// First the prediction is refined: iteratively reweighted Levenberg-Marquardt on the reprojection
/// error, the Huber width shrinking to huber_px. If fewer than half of the points then agree,
/// P3P in a RANSAC loop gives another start, and the pose with more inliers wins. A point agrees
/// if it lies in front of the camera and its error is below max_error_px.
/// The covariance is (J^T W J)^-1 of the inliers times their variance factor (never below 1/4).
/// Deterministic for a seed. Never NaN.
[[nodiscard]] Resection resect(const Camera& camera, std::span<const PointView> points,
                               const std::optional<Pose>& T_world_camera_predicted,
                               const ResectSettings& settings);

}  // namespace corvid
