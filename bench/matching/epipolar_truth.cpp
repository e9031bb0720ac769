#include "bench/matching/epipolar_truth.h"

#include <Eigen/LU>
#include <cmath>

#include "frontend/epipolar.h"

namespace corvid {

constexpr double kMinBaseline_m = 0.01;

std::optional<Eigen::Matrix3d> true_fundamental(const Camera& camera, const Pose& T_world_r,
                                                const Pose& T_world_t) {
  const Pose T_t_r = T_world_t.inverse() * T_world_r;
  if (!T_t_r.finite() || T_t_r.translation().norm() < kMinBaseline_m) return std::nullopt;
  const Eigen::Matrix3d K_inverse = camera.K().inverse();
  return K_inverse.transpose() * skew(T_t_r.translation().normalized()) * T_t_r.R() * K_inverse;
}

std::vector<double> epipolar_distances_px(const Camera& camera, const Eigen::Matrix3d& F,
                                          std::span<const Correspondence> matches) {
  std::vector<double> distances_px;
  for (const Correspondence& match : matches) {
    const auto x_r = undistort_pixel(camera, match.x_r), x_t = undistort_pixel(camera, match.x_t);
    if (!x_r || !x_t) continue;
    const Eigen::Vector3d line = F * x_r->homogeneous();
    const double norm = line.head<2>().norm();
    if (norm > 1e-12) distances_px.push_back(std::abs(line.dot(x_t->homogeneous())) / norm);
  }
  return distances_px;
}

}  // namespace corvid
