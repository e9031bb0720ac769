#pragma once

#include <Eigen/Core>
#include <optional>

#include "core/tracks.h"
#include "corvid/camera.h"
#include "corvid/pose.h"

namespace corvid {

/// Constant-velocity pose at `time_ns` from the newest poses of the backend; nothing if there are
/// none or the newest is over a second old.
[[nodiscard]] std::optional<Pose> predict_pose(const MotionState& motion, std::int64_t time_ns);

/// The landmark's position of a track, or null.
[[nodiscard]] const Eigen::Vector3d* find_landmark(const MotionState& motion, TrackId track);
/// The pose of a recent keyframe, or null.
[[nodiscard]] const Pose* find_keyframe(const MotionState& motion, FrameId frame);

/// How a template must be warped: the 2x2 matrix that takes pixel offsets around the landmark in
/// the new image to offsets in the anchor image, for a small plane through the landmark that faces
/// the anchor camera. Nothing if the plane is seen edge-on, or the scale would change by more
/// than 2.5 (then a newer template is needed).
[[nodiscard]] std::optional<Eigen::Matrix2d> predict_warp(const Camera& camera,
                                                          const Pose& T_world_anchor,
                                                          const Pose& T_world_camera,
                                                          const Eigen::Vector3d& p_world);

}  // namespace corvid
