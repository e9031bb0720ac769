#pragma once

#include <ceres/manifold.h>
#include <ceres/sized_cost_function.h>

#include "corvid/camera.h"
#include "corvid/pose.h"

namespace corvid {

/// A pose as a Ceres block: qx qy qz qw tx ty tz of T_world_camera.
using PoseBlock = std::array<double, 7>;
[[nodiscard]] PoseBlock to_block(const Pose& T_world_camera);
[[nodiscard]] Pose from_block(const double* block);

/// SE(3) with perturbation on the right, T (+) d = T * exp(d), d = (rho, phi).
///
/// The costs below write derivatives by the tangent vector into the first six of a pose's seven
/// columns. PlusJacobian is therefore [I6; 0]: only its product with the costs' Jacobian is used,
/// and that product is exact.
class PoseManifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 7; }
  int TangentSize() const override { return 6; }
  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override;
  bool PlusJacobian(const double* x, double* jacobian) const override;
  bool RightMultiplyByPlusJacobian(const double* x, int num_rows, const double* ambient_matrix,
                                   double* tangent_matrix) const override;
  bool Minus(const double* y, const double* x, double* y_minus_x) const override;
  bool MinusJacobian(const double* x, double* jacobian) const override;
};

/// Intrinsics as unknowns: log of the focal length's factor (fx/fy stays), principal point's shift
/// over the reference's fx, the distortion's five values.
using IntrinsicsBlock = std::array<double, 8>;
[[nodiscard]] IntrinsicsBlock intrinsics_block(const Camera& camera, const Camera& reference);
[[nodiscard]] Camera apply_intrinsics(const Camera& reference, const double* block);

/// weight * (project(T_world_camera^-1 * p_world) - pixel); blocks: pose, point.
/// Where the camera model does not hold the residual is a large constant, so that a step which
/// takes a point there is rejected.
class ReprojectionCost final : public ceres::SizedCostFunction<2, 7, 3> {
 public:
  ReprojectionCost(const Camera* camera, const Eigen::Vector2d& pixel, double weight)
      : camera_(camera), pixel_(pixel), weight_(weight) {}
  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  const Camera* camera_;
  Eigen::Vector2d pixel_;
  double weight_;
};

/// The same with the intrinsics as a third block.
class IntrinsicsReprojectionCost final : public ceres::SizedCostFunction<2, 7, 3, 8> {
 public:
  IntrinsicsReprojectionCost(const Camera* reference, const Eigen::Vector2d& pixel, double weight)
      : reference_(reference), pixel_(pixel), weight_(weight) {}
  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  const Camera* reference_;
  Eigen::Vector2d pixel_;
  double weight_;
};

/// (|t_b - t_a| - distance) * weight: keeps the free scale of a monocular map where it is.
class DistanceCost final : public ceres::SizedCostFunction<1, 7, 7> {
 public:
  DistanceCost(double distance, double weight) : distance_(distance), weight_(weight) {}
  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  double distance_;
  double weight_;
};

/// Gaussian prior on an IntrinsicsBlock: (block - mean) * weight, value by value.
class IntrinsicsPriorCost final : public ceres::SizedCostFunction<8, 8> {
 public:
  IntrinsicsPriorCost(const IntrinsicsBlock& mean, const IntrinsicsBlock& weights)
      : mean_(mean), weights_(weights) {}
  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  IntrinsicsBlock mean_, weights_;
};

}  // namespace corvid
