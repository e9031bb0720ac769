#pragma once

#include <ceres/autodiff_cost_function.h>
#include <ceres/jet.h>
#include <ceres/manifold.h>
#include <ceres/product_manifold.h>

#include <array>
#include <cmath>

#include "core/lens.h"
#include "corvid/camera.h"

namespace corvid {

/// ReprojectionCost and IntrinsicsReprojectionCost by Ceres' automatic derivatives, for the
/// comparison in docs/decisions/jacobians.md: the same residual from the same blocks.
struct AutomaticReprojection {
  const Camera* camera;
  Eigen::Vector2d pixel;
  double weight;

  template <class T>
  bool operator()(const T* pose, const T* point, T* residuals) const {
    const Eigen::Matrix<T, 4, 1> K(T(camera->fx_px), T(camera->fy_px), T(camera->cx_px),
                                   T(camera->cy_px));
    Eigen::Matrix<T, 5, 1> k;
    for (int i = 0; i < 5; ++i) k(i) = T(camera->distortion[static_cast<std::size_t>(i)]);
    return reproject(pose, point, K, k, residuals);
  }
  template <class T>
  bool operator()(const T* pose, const T* point, const T* intrinsics, T* residuals) const {
    using std::exp;
    const T factor = exp(intrinsics[0]);
    const Eigen::Matrix<T, 4, 1> K(factor * camera->fx_px, factor * camera->fy_px,
                                   camera->cx_px + intrinsics[1] * camera->fx_px,
                                   camera->cy_px + intrinsics[2] * camera->fx_px);
    return reproject(pose, point, K, Eigen::Matrix<T, 5, 1>(intrinsics + 3), residuals);
  }

 private:
  static double value(double x) { return x; }
  template <class T, int N>
  static double value(const ceres::Jet<T, N>& x) {
    return x.a;
  }
  template <class T>
  bool reproject(const T* pose, const T* point, const Eigen::Matrix<T, 4, 1>& K,
                 const Eigen::Matrix<T, 5, 1>& k, T* residuals) const {
    const Eigen::Map<const Eigen::Quaternion<T>> q(pose);
    const Eigen::Map<const Eigen::Matrix<T, 3, 1>> t(pose + 4), p_world(point);
    const Eigen::Matrix<T, 3, 1> p = q.conjugate() * (p_world - t);
    Eigen::Matrix<T, 2, 1> m;
    if (!(camera->model == CameraModel::equidistant ? equidistant(p, k, m) : plane(p, k, m))) {
      residuals[0] = residuals[1] = T(weight * 1000);
      return true;
    }
    for (int i = 0; i < 2; ++i) residuals[i] = weight * (K(i) * m(i) + K(2 + i) - pixel(i));
    return true;
  }
  template <class T>
  bool plane(const Eigen::Matrix<T, 3, 1>& p, const Eigen::Matrix<T, 5, 1>& k,
             Eigen::Matrix<T, 2, 1>& m) const {
    if (!(value(p.z()) > 0)) return false;
    const T x = p.x() / p.z(), y = p.y() / p.z();
    m = {x, y};
    if (camera->model == CameraModel::pinhole) return true;
    const T r2 = x * x + y * y;
    if (!lens::positive_up_to(std::array{1.0, 3 * value(k(0)), 5 * value(k(1)), 7 * value(k(4))},
                              value(r2)))
      return false;
    const T radial = 1.0 + r2 * (k(0) + r2 * (k(1) + r2 * k(4)));
    m = {x * radial + 2.0 * k(2) * x * y + k(3) * (r2 + 2.0 * x * x),
         y * radial + k(2) * (r2 + 2.0 * y * y) + 2.0 * k(3) * x * y};
    return true;
  }
  template <class T>
  bool equidistant(const Eigen::Matrix<T, 3, 1>& p, const Eigen::Matrix<T, 5, 1>& k,
                   Eigen::Matrix<T, 2, 1>& m) const {
    using std::atan2;
    using std::sqrt;
    const T r = sqrt(p.x() * p.x() + p.y() * p.y());
    if (!(value(r) > 0)) return false;
    const T theta = atan2(r, p.z()), t2 = theta * theta;
    if (!lens::positive_up_to(
            std::array{1.0, 3 * value(k(0)), 5 * value(k(1)), 7 * value(k(2)), 9 * value(k(3))},
            value(t2)))
      return false;
    const T across = theta * (1.0 + t2 * (k(0) + t2 * (k(1) + t2 * (k(2) + t2 * k(3))))) / r;
    m = {across * p.x(), across * p.y()};
    return true;
  }
};

using AutomaticReprojectionCost = ceres::AutoDiffCostFunction<AutomaticReprojection, 2, 7, 3>;
using AutomaticIntrinsicsCost = ceres::AutoDiffCostFunction<AutomaticReprojection, 2, 7, 3, 8>;
/// Quaternion and position, as the automatic derivatives by their seven numbers need it.
using AutomaticPoseManifold =
    ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>;

}  // namespace corvid
