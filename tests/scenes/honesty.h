#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <vector>

#include "core/associate.h"
#include "corvid/map.h"

namespace corvid::scenes {

/// A published pose against the truth, in units of what it claims.
struct ClaimedPose {
  std::size_t event = 0;  ///< position among the events
  TrackingState state = TrackingState::tracking;
  /// Mahalanobis distances of the error: e^T P^-1 e, square root. All six numbers, position alone,
  /// orientation alone.
  double sigmas = 0, position_sigmas = 0, orientation_sigmas = 0;
  double position_error = 0;    ///< [map units]
  double position_claimed = 0;  ///< sqrt(trace of the position's covariance) [map units]
  double orientation_error_rad = 0;
};

/// Compares what events claim with the truth, segment by segment.
///
/// A covariance is of the pose's right perturbation relative to the start of its segment, whose
/// scale is arbitrary. So the truth is brought into the segment's world by the true pose of the
/// segment's first keyframe, and by one scale: that which makes the sum of the squared
/// distances of the segment smallest (a segment has one; a scale that drifts fits no single one).
/// @param origins  where a segment's world lies: time of a frame of it and its pose there. One per
///        segment; events of a segment without one are left out.
/// A covariance that is not positive definite is infinitely far from any error.
[[nodiscard]] inline std::vector<ClaimedPose> compare_claims(
    std::span<const PoseEvent> events, const Trajectory& truth,
    const std::map<int, StampedPose>& origins) {
  struct Error {
    ClaimedPose claim;
    int segment = 0;
    Vector6d at_zero, by_scale;  // error = at_zero + scale * by_scale
    Matrix6d covariance, information;
    bool definite = false;
  };
  const auto true_pose = [&](std::int64_t time_ns) {
    return true_poses(std::vector<std::int64_t>{time_ns}, truth).front();
  };
  std::vector<Error> errors;
  std::map<int, std::pair<double, double>> scales;  // numerator, denominator
  for (std::size_t i = 0; i < events.size(); ++i) {
    const PoseEvent& event = events[i];
    if (!event.T_world_camera) continue;
    const auto origin = origins.find(event.segment);
    const auto now = true_pose(event.time_ns);
    if (origin == origins.end() || !now) continue;
    const auto then = true_pose(origin->second.time_ns);
    if (!then) continue;
    // Both relative to the origin, so that the world's own place drops out.
    const Pose estimate = origin->second.T_world_camera.inverse() * *event.T_world_camera;
    const Pose real = then->inverse() * *now;
    // log(estimate^-1 real): its translation is V^-1 R^T (s t_real - t_estimate), linear in s.
    const auto log_at = [&](double scale) {
      return (estimate.inverse() * Pose(real.rotation(), scale * real.translation())).log();
    };
    Error e;
    e.claim.event = i;
    e.claim.state = event.state;
    e.segment = event.segment;
    e.at_zero = log_at(0);
    e.by_scale = log_at(1) - e.at_zero;
    e.covariance = event.covariance;
    const Eigen::LLT<Matrix6d> llt(event.covariance);
    e.definite = llt.info() == Eigen::Success && event.covariance.allFinite();
    if (e.definite) {
      e.information = llt.solve(Matrix6d::Identity());
      scales[e.segment].first -= e.by_scale.dot(e.information * e.at_zero);
      scales[e.segment].second += e.by_scale.dot(e.information * e.by_scale);
    }
    errors.push_back(e);
  }
  std::vector<ClaimedPose> out;
  for (Error& e : errors) {
    const auto [numerator, denominator] = scales[e.segment];
    // The origin itself and a camera that stands still have no scale.
    const double scale = denominator > 0 && numerator > 0 ? numerator / denominator : 1;
    const Vector6d error = e.at_zero + scale * e.by_scale;
    const auto distance = [&](int first, int count) -> double {
      if (!e.definite) return INFINITY;
      const Eigen::MatrixXd P = e.covariance.block(first, first, count, count);
      const Eigen::VectorXd d = error.segment(first, count);
      return std::sqrt(std::max(0.0, d.dot(P.llt().solve(d))));
    };
    e.claim.sigmas = distance(0, 6);
    e.claim.position_sigmas = distance(0, 3);
    e.claim.orientation_sigmas = distance(3, 3);
    e.claim.position_error = error.head<3>().norm();
    e.claim.position_claimed = std::sqrt(std::max(0.0, e.covariance.topLeftCorner<3, 3>().trace()));
    e.claim.orientation_error_rad = error.tail<3>().norm();
    out.push_back(e.claim);
  }
  return out;
}

/// Where the worlds of a map's segments lie: at their first keyframes.
[[nodiscard]] inline std::map<int, StampedPose> segment_origins(const MapSnapshot& map) {
  std::map<int, StampedPose> origins;
  for (const auto& keyframe : map.keyframes)
    origins.try_emplace(keyframe->segment,
                        StampedPose{keyframe->frame->time_ns, keyframe->T_world_camera});
  return origins;
}

/// How far claims and errors lie apart over a run.
struct Honesty {
  std::size_t poses = 0;
  double within = 1;  ///< share of the poses within the 99.9 % of chi-square with 6 degrees: 4.74
  double median_squared = 0;  ///< of the squared distance; 5.35 if claims are exact
  double worst = 0;           ///< largest distance [sigmas]
  std::size_t worst_event = 0;
};

constexpr double kWithinSigmas = 4.74;  ///< sqrt of 22.46: 99.9 % of chi-square, 6 degrees

[[nodiscard]] inline Honesty summarise(std::span<const ClaimedPose> claims) {
  Honesty h;
  h.poses = claims.size();
  if (claims.empty()) return h;
  std::vector<double> squared;
  std::size_t within = 0;
  for (const ClaimedPose& c : claims) {
    squared.push_back(c.sigmas * c.sigmas);
    within += c.sigmas <= kWithinSigmas ? 1U : 0U;
    if (!(c.sigmas <= h.worst)) {
      h.worst = c.sigmas;
      h.worst_event = c.event;
    }
  }
  h.within = static_cast<double>(within) / static_cast<double>(claims.size());
  std::sort(squared.begin(), squared.end());
  h.median_squared = squared[squared.size() / 2];
  return h;
}

}  // namespace corvid::scenes
