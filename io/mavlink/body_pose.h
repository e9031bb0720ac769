#pragma once

#include "corvid/pose.h"
#include "corvid/position.h"

namespace corvid {

/// Where the vehicle's body (x forward, y right, z down) is in a frame with the axes north, east,
/// down [m], whose origin is that of the placement's ENU frame.
struct BodyPose {
  Pose T_ned_body;
  /// Of the position [m] and of the rotation vector about north, east, down [rad] by which the
  /// body is turned: p + d.head(3), exp(d.tail(3)) * R.
  Matrix6d covariance = Matrix6d::Zero();
};

/// Axes of a camera that is mounted on the body by turning it from looking forward, upright: first
/// roll about x, then pitch about y, then yaw about z of the body [rad]. Looking down with the
/// picture's upper edge in front: pitch -pi/2.
[[nodiscard]] Eigen::Quaterniond camera_mount(double roll_rad, double pitch_rad, double yaw_rad);

/// @param covariance  of the right perturbation of T_world_camera, as in PoseEvent.
/// @param T_body_camera  [m]
/// @pre the placement is metric.
///
/// First order. With T = T_world_camera (right perturbation rho, phi), S = T_enu_map (rho', phi',
/// sigma; s its scale) and the lever l = R_ned_camera t_camera_body:
///   d(camera)   = s R_S (R_T rho + rho' + phi' x t_T + sigma t_T)
///   d(rotation) = R_S (R_T phi + phi')
///   d(body)     = d(camera) + d(rotation) x l
[[nodiscard]] BodyPose body_pose(const Pose& T_world_camera, const Matrix6d& covariance,
                                 const MapPlacement& placement, const Pose& T_body_camera);

}  // namespace corvid
