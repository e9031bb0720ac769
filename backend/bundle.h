#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <stop_token>
#include <utility>
#include <vector>

#include "backend/intrinsics.h"
#include "backend/solve_result.h"
#include "corvid/camera.h"
#include "corvid/pose.h"

namespace corvid {

struct BundleObservation {
  int pose = 0, point = 0;  ///< positions in BundleProblem
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double sigma_px = 1;
};

/// A measured camera centre.
struct BundlePosition {
  int pose = 0;
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  Eigen::Matrix3d sqrt_information = Eigen::Matrix3d::Zero();  ///< whitens t - p_world
};

/// Poses, points and what sees what; adjust() changes poses, points and camera in place.
struct BundleProblem {
  Camera camera;
  std::vector<Pose> T_world_camera;
  std::vector<std::uint8_t> fixed;  ///< one per pose
  std::vector<Eigen::Vector3d> points;
  std::vector<BundleObservation> observations;
  std::vector<BundlePosition> positions;  ///< measured camera centres
  /// Pairs of poses whose distance is held: one for every part of the map whose scale is free.
  std::vector<std::pair<int, int>> hold_distance;
};

struct BundleSettings {
  double huber_px = 1.0;
  int max_iterations = 10;
  int threads = 1;
  double cost_tolerance =
      1e-5;  ///< stops when an iteration lowers the cost by less than this share
  /// Intrinsics that are unknowns too, weakly drawn to those of `intrinsics_prior`.
  IntrinsicsFreedom freedom = IntrinsicsFreedom::fixed;
  Camera intrinsics_prior;
  /// Ends the adjustment after the iteration that is under way.
  std::stop_token stop;
  /// Called before every iteration and after the last one, with the cost that was reached.
  std::function<void(int iteration, double cost)> on_iteration;
};

/// Bundle adjustment (algorithms.md, 6): minimises the sum of Huber(|e| * s / sigma), e the
/// reprojection error [px] in the distorted image and s the median sigma, over the free poses and
/// all points, by Levenberg-Marquardt on the Schur complement (Ceres). The Huber width is thus in
/// pixels of a typical observation. Positions count with their whitened distance, in units of the
/// variance factor of the observations as they begin, and a Huber width of four standard
/// deviations. Nothing is changed if it fails. Deterministic if threads == 1.
SolveResult adjust(BundleProblem& problem, const BundleSettings& settings);

}  // namespace corvid
