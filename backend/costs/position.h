#pragma once

#include <ceres/sized_cost_function.h>

#include <Eigen/Core>

namespace corvid {

/// sqrt_information * (t - p_world), t the translation of T_world_camera; block: the pose.
class PositionCost final : public ceres::SizedCostFunction<3, 7> {
 public:
  PositionCost(const Eigen::Vector3d& p_world, const Eigen::Matrix3d& sqrt_information)
      : p_world_(p_world), sqrt_information_(sqrt_information) {}
  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  Eigen::Vector3d p_world_;
  Eigen::Matrix3d sqrt_information_;
};

}  // namespace corvid
