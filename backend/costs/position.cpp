#include "backend/costs/position.h"

#include "backend/costs/reprojection.h"

namespace corvid {

bool PositionCost::Evaluate(const double* const* parameters, double* residuals,
                            double** jacobians) const {
  const Pose T = from_block(parameters[0]);
  Eigen::Map<Eigen::Vector3d>(residuals, 3) = sqrt_information_ * (T.translation() - p_world_);
  if (jacobians == nullptr || jacobians[0] == nullptr) return true;
  Eigen::Map<Eigen::Matrix<double, 3, 7, Eigen::RowMajor>> J(jacobians[0]);
  J.setZero();
  // t(T exp(d)) = t + R rho.
  J.leftCols<3>() = sqrt_information_ * T.R();
  return true;
}

}  // namespace corvid
