#include "io/mavlink/body_pose.h"

namespace corvid {
namespace {

/// East, north, up to north, east, down.
Eigen::Matrix3d ned_from_enu() {
  return (Eigen::Matrix3d() << 0, 1, 0, 1, 0, 0, 0, 0, -1).finished();
}

}  // namespace

Eigen::Quaterniond camera_mount(double roll_rad, double pitch_rad, double yaw_rad) {
  // Columns: the axes of a camera that looks forward, in the body: x right, y down, z forward.
  const Eigen::Matrix3d forward = (Eigen::Matrix3d() << 0, 0, 1, 1, 0, 0, 0, 1, 0).finished();
  return Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(pitch_rad, Eigen::Vector3d::UnitY()) *
         Eigen::AngleAxisd(roll_rad, Eigen::Vector3d::UnitX()) * Eigen::Quaterniond(forward);
}

BodyPose body_pose(const Pose& T_world_camera, const Matrix6d& covariance,
                   const MapPlacement& placement, const Pose& T_body_camera) {
  const Eigen::Matrix3d R_ned_enu = ned_from_enu();
  const Sim3& S = placement.T_enu_map;
  const Pose T_ned_camera = Pose(R_ned_enu, Eigen::Vector3d::Zero()) * (S * T_world_camera);
  const Pose T_camera_body = T_body_camera.inverse();
  BodyPose body;
  body.T_ned_body = T_ned_camera * T_camera_body;

  const Eigen::Matrix3d R_ned_map = R_ned_enu * S.rotation().toRotationMatrix();
  const Eigen::Matrix3d sR_ned_map = S.scale() * R_ned_map;
  const Eigen::Matrix3d lever = skew(T_ned_camera.rotation() * T_camera_body.translation());
  const Eigen::Vector3d& t = T_world_camera.translation();
  Eigen::Matrix<double, 6, 6> d_pose = Eigen::Matrix<double, 6, 6>::Zero();
  d_pose.topLeftCorner<3, 3>() = sR_ned_map * T_world_camera.R();
  d_pose.bottomRightCorner<3, 3>() = R_ned_map * T_world_camera.R();
  d_pose.topRightCorner<3, 3>() = -lever * d_pose.bottomRightCorner<3, 3>();
  Eigen::Matrix<double, 6, 7> d_place = Eigen::Matrix<double, 6, 7>::Zero();
  d_place.topLeftCorner<3, 3>() = sR_ned_map;
  d_place.block<3, 3>(3, 3) = R_ned_map;
  d_place.block<3, 3>(0, 3) = -sR_ned_map * skew(t) - lever * R_ned_map;
  d_place.topRightCorner<3, 1>() = sR_ned_map * t;
  body.covariance = d_pose * covariance * d_pose.transpose() +
                    d_place * placement.covariance * d_place.transpose();
  return body;
}

}  // namespace corvid
