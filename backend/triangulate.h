#pragma once

#include <Eigen/Core>
#include <span>

#include "corvid/camera.h"
#include "corvid/pose.h"

namespace corvid {

/// One look at a point.
struct RayView {
  Pose T_world_camera;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();        ///< in the distorted image
  Eigen::Vector3d ray_camera = Eigen::Vector3d::UnitZ();  ///< Camera::unproject(pixel)
  double sigma_px = 1;
};

enum class TriangulationStatus {
  ok,
  degenerate,     ///< the widest ray angle is too small
  behind_camera,  ///< a depth is not positive
  large_error     ///< the rays do not meet
};

struct Triangulation {
  TriangulationStatus status = TriangulationStatus::degenerate;
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();  ///< meaningful if ok
  double max_ray_angle_rad = 0;
  double max_error_px = 0;  ///< worst reprojection error over the views
};

/// A point from N viewing rays: midpoint, then Gauss-Newton on the reprojection error.
///
/// Minimises the sum over views of |project(T_world_camera^-1 p_world) - pixel|^2 / sigma^2
/// (algorithms.md, 6).
/// @param views  N >= 2 of one camera.
/// @param min_angle_rad  the widest ray angle must reach it; else `degenerate`.
/// @param max_error_px   every view's error must stay below it; else `large_error`.
/// Never NaN. Thread-safe. O(N) per iteration, O(N^2) for the angle.
[[nodiscard]] Triangulation triangulate(const Camera& camera, std::span<const RayView> views,
                                        double min_angle_rad, double max_error_px);

/// Angle between two directions [rad], exact for small ones.
[[nodiscard]] double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b);

/// The point nearest to all rays: minimises the sum of squared distances to them. Returns false
/// where the rays are parallel.
[[nodiscard]] bool nearest_point(std::span<const RayView> views, Eigen::Vector3d* p_world);

}  // namespace corvid
