#pragma once

#include <Eigen/Core>

#include "backend/bundle.h"
#include "backend/focal_belief.h"
#include "corvid/pose.h"

namespace corvid {

using Matrix7d = Eigen::Matrix<double, 7, 7>;

/// How far a camera and the scale of the scene around it have drifted since the segment's start.
///
/// Each keyframe carries a similarity, S = (scale, T_world_camera): the scale is the mean log range
/// of the landmarks that it sees, over the true one. Errors are of S's right perturbation
/// (rho [map units], phi [rad], sigma = log scale), so that a scale which is wrong here moves
/// everything that comes later (Strasdat, Montiel and Davison, "Scale drift-aware large scale
/// monocular SLAM", RSS 2010).
struct Drift {
  bool known = false;
  Matrix7d covariance = Matrix7d::Zero();  ///< from errors that differ from track to track
  Vector7d by_focal = Vector7d::Zero();    ///< error per share by which the focal length is wrong

  /// The same errors seen from a frame whose pose in this one's is T_here_there.
  [[nodiscard]] Drift seen_from(const Pose& T_here_there) const;
  /// Of the pose: with a focal length whose squared error is expected to be `focal_square`. The
  /// direction of what that does is foreseen to a quarter of its size (it is no linear thing).
  [[nodiscard]] Matrix6d pose_covariance(double focal_square) const;
};

/// Errors of tracks are not independent from image to image (a template's place, its look from
/// elsewhere): so many observations are worth one. Measured: docs/decisions/pose-covariance.md.
constexpr double kObservationsPerFact = 4;

/// Drift from one keyframe to a later one, as the images between them fix it.
struct DriftLink {
  bool ok = false;      ///< false: the poses hang together too loosely (no baseline, few points)
  Drift drift;          ///< of the similarity from `anchor` to `newest`
  FocalEstimate focal;  ///< that the residuals ask for
};

/// Linearised at the adjusted problem, points eliminated (Triggs et al., "Bundle adjustment: a
/// modern synthesis", 6.1): the marginal covariance of the similarity of pose `newest` relative to
/// that of pose `anchor`, times the variance factor of the residuals (at least 1/4); observations
/// count as independent. All other poses are free, whatever problem.fixed says; hold_distance and
/// the overall scale do not matter.
[[nodiscard]] DriftLink drift_link(const BundleProblem& problem, int anchor, int newest,
                                   double huber_px);

}  // namespace corvid
