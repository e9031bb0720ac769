#include "backend/triangulate.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "core/check.h"

namespace corvid {
namespace {

/// Sum of squared weighted errors at p, with the normal equations; infinite behind a camera.
double normal_equations(const Camera& camera, std::span<const RayView> views,
                        const Eigen::Vector3d& p_world, Eigen::Matrix3d* H, Eigen::Vector3d* g) {
  double cost = 0;
  H->setZero();
  g->setZero();
  for (const RayView& view : views) {
    const Eigen::Matrix3d R_camera_world = view.T_world_camera.R().transpose();
    Eigen::Matrix<double, 2, 3> d_point;
    const auto pixel =
        camera.project(R_camera_world * (p_world - view.T_world_camera.translation()), &d_point);
    if (!pixel) return std::numeric_limits<double>::infinity();
    const double w = 1 / (view.sigma_px * view.sigma_px);
    const Eigen::Vector2d error = *pixel - view.pixel;
    const Eigen::Matrix<double, 2, 3> J = d_point * R_camera_world;
    *H += w * J.transpose() * J;
    *g += w * J.transpose() * error;
    cost += w * error.squaredNorm();
  }
  return cost;
}

}  // namespace

double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

bool nearest_point(std::span<const RayView> views, Eigen::Vector3d* p_world) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const RayView& view : views) {
    const Eigen::Vector3d d = view.T_world_camera.rotation() * view.ray_camera;
    const Eigen::Matrix3d P = Eigen::Matrix3d::Identity() - d * d.transpose();
    A += P;
    b += P * view.T_world_camera.translation();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(A);
  if (!(eigen.eigenvalues()(0) > 1e-12 * eigen.eigenvalues()(2))) return false;
  *p_world = A.ldlt().solve(b);
  return p_world->allFinite();
}

Triangulation triangulate(const Camera& camera, std::span<const RayView> views,
                          double min_angle_rad, double max_error_px) {
  CORVID_CHECK(views.size() >= 2, "a point needs two rays");
  Triangulation result;
  for (std::size_t i = 0; i + 1 < views.size(); ++i) {
    const Eigen::Vector3d d = views[i].T_world_camera.rotation() * views[i].ray_camera;
    for (std::size_t j = i + 1; j < views.size(); ++j) {
      const double angle =
          angle_between(d, views[j].T_world_camera.rotation() * views[j].ray_camera);
      result.max_ray_angle_rad = std::max(result.max_ray_angle_rad, angle);
    }
  }
  Eigen::Vector3d p;
  if (!(result.max_ray_angle_rad >= min_angle_rad) || !nearest_point(views, &p)) return result;

  Eigen::Matrix3d H, H_new;
  Eigen::Vector3d g, g_new;
  double cost = normal_equations(camera, views, p, &H, &g);
  if (!std::isfinite(cost)) {
    result.status = TriangulationStatus::behind_camera;
    return result;
  }
  double lambda = 1e-6;
  for (int iteration = 0; iteration < 10; ++iteration) {
    Eigen::Matrix3d damped = H;
    damped.diagonal() *= 1 + lambda;
    const Eigen::Vector3d candidate = p - damped.ldlt().solve(g);
    if (!candidate.allFinite()) break;
    const double cost_new = normal_equations(camera, views, candidate, &H_new, &g_new);
    if (cost_new <= cost) {
      const bool settled = cost - cost_new <= 1e-8 * cost;
      p = candidate;
      cost = cost_new;
      H = H_new;
      g = g_new;
      lambda *= 0.1;
      if (settled) break;
    } else {
      lambda = std::max(lambda, 1e-4) * 10;
    }
  }
  for (const RayView& view : views) {
    const Eigen::Vector3d p_camera = view.T_world_camera.inverse() * p;
    const auto pixel = camera.project(p_camera);
    if (!pixel || p_camera.dot(view.ray_camera) <= 0) {
      result.status = TriangulationStatus::behind_camera;
      return result;
    }
    result.max_error_px = std::max(result.max_error_px, (*pixel - view.pixel).norm());
  }
  result.p_world = p;
  result.status = result.max_error_px < max_error_px ? TriangulationStatus::ok
                                                     : TriangulationStatus::large_error;
  return result;
}

}  // namespace corvid
