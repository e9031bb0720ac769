#pragma once

#include <Eigen/Core>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "corvid/frame.h"
#include "corvid/ids.h"
#include "corvid/pose.h"

namespace corvid {

/// One feature in one frame: what the frontend tells the backend.
struct TrackObservation {
  TrackId track;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  ///< in the camera's own (distorted) image
  float score = 0;                                  ///< NCC score of the match, 1 for a new feature
  /// Of the position relative to the track's first one [px^2]: from the shape of the correlation
  /// peak and the score, plus that of the place where the template was cut.
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Identity();
};

/// Standard deviation along the axis on which a position is least certain [px].
[[nodiscard]] inline double largest_sigma_px(const Eigen::Matrix2d& covariance_px2) {
  const double mean = 0.5 * covariance_px2.trace();
  const double half_difference = 0.5 * (covariance_px2(0, 0) - covariance_px2(1, 1));
  return std::sqrt(mean + std::hypot(half_difference, covariance_px2(0, 1)));
}

/// All features of one frame, sorted by track.
struct FrameTracks {
  FramePtr frame;
  bool keyframe = false;
  std::vector<TrackObservation> observations;
};

/// What the backend tells the frontend: where the camera is and where the tracked landmarks are,
/// so that the next frame's search is bounded. Immutable once published.
struct MotionState {
  /// Poses of the last two frames that have one, newest last; empty while starting or lost.
  std::vector<StampedPose> recent;
  /// Poses of the recent keyframes, sorted by frame: templates are warped from the frame in which
  /// they were cut. At least the keyframes of the adjusted window.
  std::vector<std::pair<FrameId, Pose>> keyframes;
  /// The camera that goes with these poses and landmarks, where the backend refines intrinsics;
  /// null: the frame's own.
  std::shared_ptr<const Camera> camera;
  /// Position of each live landmark in the world, sorted by track.
  std::vector<std::pair<TrackId, Eigen::Vector3d>> landmarks;
  /// Tracks that the backend found to be wrong since the last state; the frontend ends them.
  std::vector<TrackId> rejected;
};

}  // namespace corvid
