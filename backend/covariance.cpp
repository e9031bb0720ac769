#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "backend/bundle.h"
#include "core/check.h"

namespace corvid {

// Schur complement onto the free poses (Triggs et al., "Bundle adjustment: a modern
// synthesis", 6.1): S = U - sum over points of W V^-1 W^T.
Matrix6d pose_covariance(const BundleProblem& problem, int pose, double huber_px) {
  const auto poses = problem.T_world_camera.size();
  CORVID_CHECK(pose >= 0 && static_cast<std::size_t>(pose) < poses, "no such pose");
  std::vector<int> column(poses, -1);
  int free = 0;
  for (std::size_t i = 0; i < poses; ++i) {
    if (problem.fixed[i] == 0) column[i] = free++;
  }
  if (column[static_cast<std::size_t>(pose)] < 0) return Matrix6d::Zero();

  using Matrix63 = Eigen::Matrix<double, 6, 3>;
  struct Link {
    int column;
    Matrix63 W;
  };
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(6 * free, 6 * free);
  std::vector<Eigen::Matrix3d> V(problem.points.size(), Eigen::Matrix3d::Zero());
  std::vector<std::vector<Link>> links(problem.points.size());
  double cost = 0, rows = 0;
  for (const BundleObservation& o : problem.observations) {
    const Pose& T = problem.T_world_camera[static_cast<std::size_t>(o.pose)];
    const auto point = static_cast<std::size_t>(o.point);
    const Eigen::Matrix3d R_camera_world = T.R().transpose();
    const Eigen::Vector3d p_camera = R_camera_world * (problem.points[point] - T.translation());
    Eigen::Matrix<double, 2, 3> d_point;
    const auto pixel = problem.camera.project(p_camera, &d_point);
    if (!pixel) continue;
    const Eigen::Vector2d error = (*pixel - o.pixel) / o.sigma_px;
    const double width = huber_px / o.sigma_px;
    const double weight = error.norm() <= width ? 1 : width / error.norm();
    cost += weight * error.squaredNorm();
    rows += 2;
    const Eigen::Matrix<double, 2, 3> Jp = d_point * R_camera_world / o.sigma_px;
    V[point] += weight * Jp.transpose() * Jp;
    const int c = column[static_cast<std::size_t>(o.pose)];
    if (c < 0) continue;
    Eigen::Matrix<double, 2, 6> Jc;
    Jc.leftCols<3>() = -d_point / o.sigma_px;
    Jc.rightCols<3>() = d_point * skew(p_camera) / o.sigma_px;
    S.block<6, 6>(6 * c, 6 * c) += weight * Jc.transpose() * Jc;
    links[point].push_back({c, weight * Jc.transpose() * Jp});
  }
  double unknowns = 6.0 * free;
  for (std::size_t i = 0; i < links.size(); ++i) {
    if (links[i].empty()) continue;
    unknowns += 3;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(V[i]);
    if (!(eigen.eigenvalues()(0) > 1e-12 * eigen.eigenvalues()(2))) continue;
    const Eigen::Matrix3d V_inverse = V[i].inverse();
    for (const Link& a : links[i]) {
      const Matrix63 WV = a.W * V_inverse;
      for (const Link& b : links[i]) {
        S.block<6, 6>(6 * a.column, 6 * b.column).noalias() -= WV * b.W.transpose();
      }
    }
  }
  for (const auto& [a, b] : problem.hold_distance) {
    const Pose& Ta = problem.T_world_camera[static_cast<std::size_t>(a)];
    const Pose& Tb = problem.T_world_camera[static_cast<std::size_t>(b)];
    const Eigen::Vector3d d = Tb.translation() - Ta.translation();
    if (!(d.norm() > 0)) continue;
    const double weight = 1e8 / d.squaredNorm();
    const Eigen::Vector3d ua = Ta.R().transpose() * d.normalized();
    const Eigen::Vector3d ub = Tb.R().transpose() * d.normalized();
    const int ca = column[static_cast<std::size_t>(a)], cb = column[static_cast<std::size_t>(b)];
    if (ca >= 0) S.block<3, 3>(6 * ca, 6 * ca) += weight * ua * ua.transpose();
    if (cb >= 0) S.block<3, 3>(6 * cb, 6 * cb) += weight * ub * ub.transpose();
    if (ca >= 0 && cb >= 0) {
      S.block<3, 3>(6 * ca, 6 * cb) -= weight * ua * ub.transpose();
      S.block<3, 3>(6 * cb, 6 * ca) -= weight * ub * ua.transpose();
    }
  }
  const Eigen::LDLT<Eigen::MatrixXd> ldlt(S);
  if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return Matrix6d::Zero();
  Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(6 * free, 6);
  unit.middleRows<6>(6 * column[static_cast<std::size_t>(pose)]).setIdentity();
  const Matrix6d block = ldlt.solve(unit).middleRows<6>(6 * column[static_cast<std::size_t>(pose)]);
  const double variance = std::max(0.25, cost / std::max(1.0, rows - unknowns));
  const Matrix6d covariance = 0.5 * variance * (block + block.transpose());
  return covariance.allFinite() ? covariance : Matrix6d::Zero();
}

}  // namespace corvid
