#include "backend/drift.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "core/check.h"
#include "core/median.h"

namespace corvid {
namespace {

// Columns of the right-hand sides: the newest pose, the mean log range seen from the newest pose
// and from the anchor, what the focal length does to the cost's gradient, and that gradient.
constexpr int kPose = 0, kScale = 6, kAnchorScale = 7, kFocal = 8, kGradient = 9, kColumns = 10;
using Columns3 = Eigen::Matrix<double, 3, kColumns>;
using Columns6 = Eigen::Matrix<double, 6, kColumns>;
using Gram = Eigen::Matrix<double, kColumns, kColumns>;
using Matrix63 = Eigen::Matrix<double, 6, 3>;

/// Adjoint of the similarity (1, T) on (rho, phi, sigma).
Matrix7d similarity_adjoint(const Pose& T) {
  Matrix7d Ad = Matrix7d::Zero();
  Ad.topLeftCorner<6, 6>() = T.adjoint();
  Ad.block<3, 1>(0, 6) = -T.translation();
  Ad(6, 6) = 1;
  return Ad;
}

/// One observation, linearised; all weighted by its robust weight and its standard deviation.
struct Row {
  int pose = 0;
  Eigen::Vector2d error;
  Eigen::Vector2d by_focal;  ///< by the log of the focal length
  Eigen::Matrix<double, 2, 6> by_pose;
  Eigen::Matrix<double, 2, 3> by_point;
};

std::optional<Row> linearize(const BundleProblem& problem, const BundleObservation& o,
                             double huber_sigmas) {
  const Pose& T = problem.T_world_camera[static_cast<std::size_t>(o.pose)];
  const Eigen::Matrix3d R_camera_world = T.R().transpose();
  const Eigen::Vector3d p_camera =
      R_camera_world * (problem.points[static_cast<std::size_t>(o.point)] - T.translation());
  Eigen::Matrix<double, 2, 3> d_point;
  Eigen::Matrix<double, 2, Camera::kIntrinsics> d_intrinsics;
  const auto pixel = problem.camera.project(p_camera, &d_point, &d_intrinsics);
  if (!pixel) return std::nullopt;
  Row row;
  row.pose = o.pose;
  row.error = (*pixel - o.pixel) / o.sigma_px;
  const double e = row.error.norm();
  const double weight = std::sqrt(e <= huber_sigmas ? 1 : huber_sigmas / e) / o.sigma_px;
  row.error *= weight * o.sigma_px;
  row.by_focal = weight * (problem.camera.fx_px * d_intrinsics.col(0) +
                           problem.camera.fy_px * d_intrinsics.col(1));
  row.by_pose.leftCols<3>() = -weight * d_point;
  row.by_pose.rightCols<3>() = weight * d_point * skew(p_camera);
  row.by_point = weight * d_point * R_camera_world;
  return row;
}

/// The normal equations with the points eliminated.
struct Reduced {
  Eigen::MatrixXd S;              ///< 6 x 6 blocks of the free poses
  Eigen::MatrixXd right;          ///< right-hand sides, reduced
  Gram of_points = Gram::Zero();  ///< B_p^T V^-1 B_p, summed over the points
  double focal_curvature = 0, focal_gradient = 0;
  double scale_weight = 0, anchor_scale_weight = 0;
  double cost = 0, rows = 0, unknowns = 0;
};

/// Adds a point with all its rows.
void eliminate(const BundleProblem& problem, const Eigen::Vector3d& p_world,
               const std::vector<Row>& rows, const std::vector<int>& column, int anchor, int newest,
               Reduced* n) {
  Eigen::Matrix3d V = Eigen::Matrix3d::Zero();
  for (const Row& row : rows) V.noalias() += row.by_point.transpose() * row.by_point;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(V);
  if (!(eigen.eigenvalues()(0) > 1e-9 * eigen.eigenvalues()(2))) return;
  const Eigen::Matrix3d V_inverse = V.inverse();

  Columns3 B = Columns3::Zero();
  for (const Row& row : rows) {
    B.col(kFocal).noalias() += row.by_point.transpose() * row.by_focal;
    B.col(kGradient).noalias() += row.by_point.transpose() * row.error;
    n->focal_curvature += row.by_focal.squaredNorm();
    n->focal_gradient += row.by_focal.dot(row.error);
    n->cost += row.error.squaredNorm();
    n->rows += 2;
    // Points with a well-known range say what the scale is.
    if (row.pose != anchor && row.pose != newest) continue;
    const Pose& T = problem.T_world_camera[static_cast<std::size_t>(row.pose)];
    const Eigen::Vector3d ray = p_world - T.translation();
    const double range2 = ray.squaredNorm();
    const double variance = ray.dot(V_inverse * ray) / (range2 * range2);
    if (!(variance > 0)) continue;
    if (row.pose == anchor) {
      B.col(kAnchorScale) = ray / range2 / variance;
      n->anchor_scale_weight += 1 / variance;
    } else {
      B.col(kScale) = ray / range2 / variance;
      n->scale_weight += 1 / variance;
      const int c = 6 * column[static_cast<std::size_t>(newest)];
      n->right.block<3, 1>(c, kScale) -= T.R().transpose() * ray / range2 / variance;
    }
  }
  n->unknowns += 3;
  n->of_points.noalias() += B.transpose() * V_inverse * B;
  std::vector<std::pair<int, Matrix63>> links;
  for (const Row& row : rows) {
    const int c = column[static_cast<std::size_t>(row.pose)];
    if (c < 0) continue;
    n->S.block<6, 6>(6 * c, 6 * c).noalias() += row.by_pose.transpose() * row.by_pose;
    n->right.block<6, 1>(6 * c, kFocal).noalias() += row.by_pose.transpose() * row.by_focal;
    n->right.block<6, 1>(6 * c, kGradient).noalias() += row.by_pose.transpose() * row.error;
    links.emplace_back(c, row.by_pose.transpose() * row.by_point);
  }
  for (const auto& [a, W] : links) {
    const Matrix63 WV = W * V_inverse;
    n->right.middleRows<6>(6 * a).noalias() -= WV * B;
    for (const auto& [b, W_b] : links) {
      if (b <= a) n->S.block<6, 6>(6 * a, 6 * b).noalias() -= WV * W_b.transpose();
    }
  }
}

/// Holds the distance of a pose from the anchor: the scale of everything is free, any gauge does.
void hold_scale(const BundleProblem& problem, const std::vector<int>& column, int anchor,
                Reduced* n) {
  const Eigen::Vector3d& from =
      problem.T_world_camera[static_cast<std::size_t>(anchor)].translation();
  std::size_t farthest = 0;
  double distance2 = 0;
  for (std::size_t i = 0; i < column.size(); ++i) {
    const double d2 = (problem.T_world_camera[i].translation() - from).squaredNorm();
    if (column[i] < 0 || d2 <= distance2) continue;
    distance2 = d2;
    farthest = i;
  }
  if (!(distance2 > 0)) return;
  const Pose& T = problem.T_world_camera[farthest];
  const Eigen::Vector3d u = T.R().transpose() * (T.translation() - from).normalized();
  const int c = 6 * column[farthest];
  const double weight = 1e3 * n->S.block<3, 3>(c, c).trace();
  n->S.block<3, 3>(c, c) += weight * u * u.transpose();
}

}  // namespace

Drift Drift::seen_from(const Pose& T_here_there) const {
  // S exp(d) T = S T exp(Ad(T^-1) d).
  const Matrix7d Ad = similarity_adjoint(T_here_there.inverse());
  return {known, Ad * covariance * Ad.transpose(), Ad * by_focal};
}

Matrix6d Drift::pose_covariance(double focal_square) const {
  constexpr double kUnforeseen = 0.25;
  const Vector6d b = by_focal.head<6>();
  Matrix6d by = b * b.transpose();
  by.diagonal().head<3>().array() += kUnforeseen * kUnforeseen * b.head<3>().squaredNorm();
  by.diagonal().tail<3>().array() += kUnforeseen * kUnforeseen * b.tail<3>().squaredNorm();
  return covariance.topLeftCorner<6, 6>() + focal_square * by;
}

DriftLink drift_link(const BundleProblem& problem, int anchor, int newest, double huber_px) {
  const auto poses = problem.T_world_camera.size();
  const auto exists = [&](int i) { return i >= 0 && static_cast<std::size_t>(i) < poses; };
  CORVID_CHECK(exists(anchor) && exists(newest) && anchor != newest, "no such pair of poses");
  DriftLink link;
  if (problem.observations.empty()) return link;
  std::vector<double> sigmas;
  std::vector<std::vector<const BundleObservation*>> of_point(problem.points.size());
  for (const BundleObservation& o : problem.observations) {
    sigmas.push_back(o.sigma_px);
    of_point[static_cast<std::size_t>(o.point)].push_back(&o);
  }
  const double huber_sigmas = huber_px / upper_median(std::move(sigmas));

  std::vector<int> column(poses, -1);
  int free = 0;
  for (std::size_t i = 0; i < poses; ++i) {
    if (static_cast<int>(i) != anchor) column[i] = free++;
  }
  Reduced n;
  n.S = Eigen::MatrixXd::Zero(6 * free, 6 * free);
  n.right = Eigen::MatrixXd::Zero(6 * free, kColumns);
  std::vector<Row> rows;
  for (std::size_t p = 0; p < of_point.size(); ++p) {
    rows.clear();
    for (const BundleObservation* o : of_point[p]) {
      if (auto row = linearize(problem, *o, huber_sigmas)) rows.push_back(*row);
    }
    if (rows.size() >= 2) eliminate(problem, problem.points[p], rows, column, anchor, newest, &n);
  }
  n.unknowns += 6.0 * free - 1;
  if (!(n.scale_weight > 0) || !(n.anchor_scale_weight > 0) || !(n.rows > n.unknowns)) return link;
  n.right.block<6, 6>(6 * column[static_cast<std::size_t>(newest)], kPose).setIdentity();
  hold_scale(problem, column, anchor, &n);

  const Eigen::MatrixXd S = n.S.selfadjointView<Eigen::Lower>();
  const Eigen::LDLT<Eigen::MatrixXd> ldlt(S);
  if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return link;
  Gram G = n.of_points + n.right.transpose() * ldlt.solve(n.right);
  for (const auto& [c, weight] :
       {std::pair(kScale, n.scale_weight), std::pair(kAnchorScale, n.anchor_scale_weight)}) {
    G.row(c) /= weight;
    G.col(c) /= weight;
  }
  // The similarity relative to the anchor's: the anchor's scale shrinks what is measured from it.
  const Pose T_anchor_newest = problem.T_world_camera[static_cast<std::size_t>(anchor)].inverse() *
                               problem.T_world_camera[static_cast<std::size_t>(newest)];
  Eigen::Matrix<double, 7, 8> relative = Eigen::Matrix<double, 7, 8>::Zero();
  relative.leftCols<7>().setIdentity();
  relative.block<3, 1>(0, kAnchorScale) =
      -(T_anchor_newest.rotation().conjugate() * T_anchor_newest.translation());
  relative(6, kAnchorScale) = -1;

  const double variance = std::max(0.25, n.cost / (n.rows - n.unknowns));
  link.drift.known = true;
  link.drift.covariance = variance * relative * G.topLeftCorner<8, 8>() * relative.transpose();
  link.drift.covariance = 0.5 * (link.drift.covariance + link.drift.covariance.transpose()).eval();
  link.drift.by_focal = -relative * G.block<8, 1>(0, kFocal);
  const double curvature = n.focal_curvature - G(kFocal, kFocal);
  const double gradient = n.focal_gradient - G(kFocal, kGradient);
  if (curvature > 1e-9 * n.focal_curvature) {
    link.focal = {-gradient / curvature, std::sqrt(variance / curvature)};
  }
  link.ok = link.drift.covariance.allFinite() && link.drift.by_focal.allFinite() &&
            std::isfinite(link.focal.share) && std::isfinite(link.focal.sigma);
  return link;
}

}  // namespace corvid
