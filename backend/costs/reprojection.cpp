#include "backend/costs/reprojection.h"

#include <algorithm>
#include <cmath>

namespace corvid {
namespace {

template <int Rows, int Cols>
using RowMajor = Eigen::Matrix<double, Rows, Cols, Eigen::RowMajor>;
using Jacobian27 = Eigen::Map<RowMajor<2, 7>>;
using Jacobian23 = Eigen::Map<RowMajor<2, 3>>;

constexpr double kOutsideModelPx = 1000;  ///< residual where the camera model does not hold

/// Residual and Jacobians by pose and point; `d_intrinsics` if not null.
bool evaluate(const Camera& camera, const Eigen::Vector2d& pixel, double weight, const double* pose,
              const double* point, double* residuals, double* d_pose, double* d_world_point,
              Eigen::Matrix<double, 2, Camera::kIntrinsics>* d_intrinsics) {
  const Eigen::Map<const Eigen::Quaterniond> q(pose);
  const Eigen::Map<const Eigen::Vector3d> t(pose + 4);
  const Eigen::Map<const Eigen::Vector3d> p_world(point);
  const Eigen::Matrix3d R_camera_world = q.toRotationMatrix().transpose();
  const Eigen::Vector3d p_camera = R_camera_world * (p_world - t);
  Eigen::Matrix<double, 2, 3> d_point;
  const bool need = d_pose != nullptr || d_world_point != nullptr;
  const auto projected = camera.project(p_camera, need ? &d_point : nullptr, d_intrinsics);
  if (!projected) {
    residuals[0] = residuals[1] = weight * kOutsideModelPx;
    if (d_pose != nullptr) std::fill_n(d_pose, 14, 0.0);
    if (d_world_point != nullptr) std::fill_n(d_world_point, 6, 0.0);
    if (d_intrinsics != nullptr) d_intrinsics->setZero();
    return true;
  }
  Eigen::Map<Eigen::Vector2d>(residuals, 2) = weight * (*projected - pixel);
  if (need) d_point *= weight;
  if (d_pose != nullptr) {
    // p_camera(T exp(d)) = p_camera - rho + p_camera x phi + O(d^2).
    Jacobian27 J(d_pose);
    J.leftCols<3>() = -d_point;
    J.middleCols<3>(3) = d_point * skew(p_camera);
    J.rightCols<1>().setZero();
  }
  if (d_world_point != nullptr) Jacobian23(d_world_point).noalias() = d_point * R_camera_world;
  return true;
}

}  // namespace

PoseBlock to_block(const Pose& T) {
  const Eigen::Quaterniond& q = T.rotation();
  const Eigen::Vector3d& t = T.translation();
  return {q.x(), q.y(), q.z(), q.w(), t.x(), t.y(), t.z()};
}

Pose from_block(const double* block) {
  return {Eigen::Quaterniond(block[3], block[0], block[1], block[2]),
          Eigen::Vector3d(block[4], block[5], block[6])};
}

bool PoseManifold::Plus(const double* x, const double* delta, double* x_plus_delta) const {
  const Pose moved = from_block(x) * Pose::exp(Eigen::Map<const Vector6d>(delta));
  const PoseBlock block = to_block(moved);
  std::copy(block.begin(), block.end(), x_plus_delta);
  return true;
}

bool PoseManifold::PlusJacobian(const double*, double* jacobian) const {
  Eigen::Map<RowMajor<7, 6>> J(jacobian);
  J.setZero();
  J.topRows<6>().setIdentity();
  return true;
}

bool PoseManifold::RightMultiplyByPlusJacobian(const double*, int num_rows,
                                               const double* ambient_matrix,
                                               double* tangent_matrix) const {
  using Dynamic7 = Eigen::Matrix<double, Eigen::Dynamic, 7, Eigen::RowMajor>;
  using Dynamic6 = Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor>;
  Eigen::Map<Dynamic6>(tangent_matrix, num_rows, 6) =
      Eigen::Map<const Dynamic7>(ambient_matrix, num_rows, 7).leftCols<6>();
  return true;
}

bool PoseManifold::Minus(const double* y, const double* x, double* y_minus_x) const {
  Eigen::Map<Vector6d>(y_minus_x, 6) = (from_block(x).inverse() * from_block(y)).log();
  return true;
}

bool PoseManifold::MinusJacobian(const double*, double* jacobian) const {
  Eigen::Map<RowMajor<6, 7>> J(jacobian);
  J.setZero();
  J.leftCols<6>().setIdentity();
  return true;
}

IntrinsicsBlock intrinsics_block(const Camera& camera, const Camera& reference) {
  IntrinsicsBlock block{std::log(camera.fx_px / reference.fx_px),
                        (camera.cx_px - reference.cx_px) / reference.fx_px,
                        (camera.cy_px - reference.cy_px) / reference.fx_px};
  std::copy(camera.distortion.begin(), camera.distortion.end(), block.begin() + 3);
  return block;
}

Camera apply_intrinsics(const Camera& reference, const double* block) {
  Camera camera = reference;
  const double factor = std::exp(block[0]);
  camera.fx_px *= factor;
  camera.fy_px *= factor;
  camera.cx_px += block[1] * reference.fx_px;
  camera.cy_px += block[2] * reference.fx_px;
  std::copy(block + 3, block + 8, camera.distortion.begin());
  return camera;
}

bool ReprojectionCost::Evaluate(const double* const* parameters, double* residuals,
                                double** jacobians) const {
  return evaluate(*camera_, pixel_, weight_, parameters[0], parameters[1], residuals,
                  jacobians != nullptr ? jacobians[0] : nullptr,
                  jacobians != nullptr ? jacobians[1] : nullptr, nullptr);
}

bool IntrinsicsReprojectionCost::Evaluate(const double* const* parameters, double* residuals,
                                          double** jacobians) const {
  const Camera camera = apply_intrinsics(*reference_, parameters[2]);
  double* const d_block = jacobians != nullptr ? jacobians[2] : nullptr;
  Eigen::Matrix<double, 2, Camera::kIntrinsics> d_intrinsics;
  evaluate(camera, pixel_, weight_, parameters[0], parameters[1], residuals,
           jacobians != nullptr ? jacobians[0] : nullptr,
           jacobians != nullptr ? jacobians[1] : nullptr,
           d_block != nullptr ? &d_intrinsics : nullptr);
  if (d_block != nullptr) {
    Eigen::Map<RowMajor<2, 8>> J(d_block);
    J.col(0) = weight_ * (d_intrinsics.col(0) * camera.fx_px + d_intrinsics.col(1) * camera.fy_px);
    J.middleCols<2>(1) = weight_ * reference_->fx_px * d_intrinsics.middleCols<2>(2);
    J.rightCols<5>() = weight_ * d_intrinsics.rightCols<5>();
  }
  return true;
}

bool DistanceCost::Evaluate(const double* const* parameters, double* residuals,
                            double** jacobians) const {
  const Pose a = from_block(parameters[0]);
  const Pose b = from_block(parameters[1]);
  const Eigen::Vector3d d = b.translation() - a.translation();
  const double length = d.norm();
  residuals[0] = weight_ * (length - distance_);
  if (jacobians == nullptr) return true;
  const Eigen::Vector3d u = length > 0 ? Eigen::Vector3d(d / length) : Eigen::Vector3d::Zero();
  for (int k = 0; k < 2; ++k) {
    if (jacobians[k] == nullptr) continue;
    Eigen::Map<Eigen::Matrix<double, 1, 7>> J(jacobians[k]);
    J.setZero();
    // t(T exp(d)) = t + R rho.
    J.leftCols<3>() = (k == 0 ? -weight_ : weight_) * u.transpose() * (k == 0 ? a : b).R();
  }
  return true;
}

bool IntrinsicsPriorCost::Evaluate(const double* const* parameters, double* residuals,
                                   double** jacobians) const {
  Eigen::Map<Eigen::Array<double, 8, 1>> r(residuals);
  const Eigen::Map<const Eigen::Array<double, 8, 1>> x(parameters[0]), mean(mean_.data()),
      weights(weights_.data());
  r = weights * (x - mean);
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    Eigen::Map<RowMajor<8, 8>> J(jacobians[0]);
    J = weights.matrix().asDiagonal();
  }
  return true;
}

}  // namespace corvid
