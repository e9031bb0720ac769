#include "frontend/predict.h"

#include <algorithm>
#include <cmath>

namespace corvid {

std::optional<Pose> predict_pose(const MotionState& motion, std::int64_t time_ns) {
  if (motion.recent.empty()) return std::nullopt;
  const StampedPose& last = motion.recent.back();
  constexpr std::int64_t kMaxAgeNs = 1'000'000'000;
  const std::int64_t ahead_ns = time_ns - last.time_ns;
  if (ahead_ns < 0 || ahead_ns > kMaxAgeNs) return std::nullopt;
  if (motion.recent.size() < 2) return last.T_world_camera;
  const StampedPose& before = motion.recent[motion.recent.size() - 2];
  const std::int64_t step_ns = last.time_ns - before.time_ns;
  if (step_ns <= 0 || step_ns > kMaxAgeNs) return last.T_world_camera;
  const double ratio = std::min(4.0, static_cast<double>(ahead_ns) / static_cast<double>(step_ns));
  const Vector6d velocity = (before.T_world_camera.inverse() * last.T_world_camera).log();
  return last.T_world_camera * Pose::exp(ratio * velocity);
}

const Eigen::Vector3d* find_landmark(const MotionState& motion, TrackId track) {
  const auto it = std::lower_bound(motion.landmarks.begin(), motion.landmarks.end(), track,
                                   [](const auto& entry, TrackId id) { return entry.first < id; });
  return it != motion.landmarks.end() && it->first == track ? &it->second : nullptr;
}

const Pose* find_keyframe(const MotionState& motion, FrameId frame) {
  const auto it = std::lower_bound(motion.keyframes.begin(), motion.keyframes.end(), frame,
                                   [](const auto& entry, FrameId id) { return entry.first < id; });
  return it != motion.keyframes.end() && it->first == frame ? &it->second : nullptr;
}

std::optional<Eigen::Matrix2d> predict_warp(const Camera& camera, const Pose& T_world_anchor,
                                            const Pose& T_world_camera,
                                            const Eigen::Vector3d& p_world) {
  const Pose T_anchor_camera = T_world_anchor.inverse() * T_world_camera;
  const Eigen::Vector3d p_anchor = T_world_anchor.inverse() * p_world;
  const Eigen::Vector3d p_camera = T_world_camera.inverse() * p_world;
  const Eigen::Vector3d normal = p_anchor.normalized();
  const auto x_anchor = camera.project(p_anchor);
  const auto x_camera = camera.project(p_camera);
  if (!x_anchor || !x_camera) return std::nullopt;
  constexpr double kStepPx = 4;
  Eigen::Matrix2d warp;
  for (int axis = 0; axis < 2; ++axis) {
    const auto ray = camera.unproject(*x_camera + kStepPx * Eigen::Vector2d::Unit(axis));
    if (!ray) return std::nullopt;
    const Eigen::Vector3d direction = T_anchor_camera.rotation() * *ray;
    const double facing = normal.dot(direction);
    if (facing < 0.2) return std::nullopt;
    const double distance = normal.dot(p_anchor - T_anchor_camera.translation()) / facing;
    if (distance <= 0) return std::nullopt;
    const auto pixel = camera.project(T_anchor_camera.translation() + distance * direction);
    if (!pixel) return std::nullopt;
    warp.col(axis) = (*pixel - *x_anchor) / kStepPx;
  }
  const double area = warp.determinant();
  if (!(area > 1 / 6.25) || !(area < 6.25)) return std::nullopt;
  return warp;
}

}  // namespace corvid
