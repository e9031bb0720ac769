#include "frontend/epipolar.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>

namespace corvid {
namespace {

using Points = std::span<const Eigen::Vector2d>;

/// Moves the centroid to the origin and the mean distance to sqrt(2).
Eigen::Matrix3d normalizing_transform(Points points, std::span<const int> subset) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (int i : subset) mean += points[static_cast<std::size_t>(i)];
  mean /= static_cast<double>(subset.size());
  double distance = 0;
  for (int i : subset) distance += (points[static_cast<std::size_t>(i)] - mean).norm();
  distance /= static_cast<double>(subset.size());
  const double s = distance > 1e-12 ? std::sqrt(2.0) / distance : 1.0;
  Eigen::Matrix3d T;
  T << s, 0, -s * mean.x(), 0, s, -s * mean.y(), 0, 0, 1;
  return T;
}

std::optional<Eigen::Matrix3d> eight_point(Points x_r, Points x_t, std::span<const int> subset) {
  const Eigen::Matrix3d T_r = normalizing_transform(x_r, subset);
  const Eigen::Matrix3d T_t = normalizing_transform(x_t, subset);
  Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
  for (int i : subset) {
    const Eigen::Vector3d r = T_r * x_r[static_cast<std::size_t>(i)].homogeneous();
    const Eigen::Vector3d t = T_t * x_t[static_cast<std::size_t>(i)].homogeneous();
    Eigen::Matrix<double, 9, 1> row;
    row << t.x() * r, t.y() * r, t.z() * r;
    normal.selfadjointView<Eigen::Lower>().rankUpdate(row);
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> solver(normal);
  if (solver.info() != Eigen::Success) return std::nullopt;
  const Eigen::Matrix<double, 9, 1> f = solver.eigenvectors().col(0);
  Eigen::Matrix3d F;
  F << f.segment<3>(0).transpose(), f.segment<3>(3).transpose(), f.segment<3>(6).transpose();
  Eigen::JacobiSVD<Eigen::Matrix3d> svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d sigma = svd.singularValues();
  sigma.z() = 0;
  F = T_t.transpose() * (svd.matrixU() * sigma.asDiagonal() * svd.matrixV().transpose()) * T_r;
  const double norm = F.norm();
  if (!(norm > 1e-300) || !F.allFinite()) return std::nullopt;
  return F / norm;
}

int count_inliers(const Eigen::Matrix3d& F, Points x_r, Points x_t, double max_distance_px,
                  std::vector<bool>* inlier) {
  int count = 0;
  for (std::size_t i = 0; i < x_r.size(); ++i) {
    const bool in = sampson_distance_px(F, x_r[i], x_t[i]) <= max_distance_px;
    if (inlier) (*inlier)[i] = in;
    count += in;
  }
  return count;
}

}  // namespace

double sampson_distance_px(const Eigen::Matrix3d& F, const Eigen::Vector2d& x_r,
                           const Eigen::Vector2d& x_t) {
  const Eigen::Vector3d line_t = F * x_r.homogeneous();
  const Eigen::Vector3d line_r = F.transpose() * x_t.homogeneous();
  const double gradient =
      std::sqrt(line_t.head<2>().squaredNorm() + line_r.head<2>().squaredNorm());
  if (gradient < 1e-300) return 0;  // both points are epipoles: the constraint says nothing
  return std::abs(x_t.homogeneous().dot(line_t)) / gradient;
}

std::optional<EpipolarGeometry> estimate_fundamental(Points x_r, Points x_t, double max_distance_px,
                                                     std::uint64_t seed) {
  const int n = static_cast<int>(x_r.size());
  if (n < 8 || x_t.size() != x_r.size()) return std::nullopt;
  constexpr int kMaxTrials = 2000;
  constexpr double kConfidence = 0.999;
  std::mt19937_64 random(seed);
  std::vector<int> order(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) order[static_cast<std::size_t>(i)] = i;

  EpipolarGeometry best;
  int trials = kMaxTrials;
  for (int trial = 0; trial < trials; ++trial) {
    for (int k = 0; k < 8; ++k) {  // partial Fisher-Yates; the modulo's bias is far below 1e-12
      const auto j = k + static_cast<int>(random() % static_cast<std::uint64_t>(n - k));
      std::swap(order[static_cast<std::size_t>(k)], order[static_cast<std::size_t>(j)]);
    }
    const auto F = eight_point(x_r, x_t, std::span<const int>(order.data(), 8));
    if (!F) continue;
    const int inliers = count_inliers(*F, x_r, x_t, max_distance_px, nullptr);
    if (inliers <= best.inliers) continue;
    best.F = *F;
    best.inliers = inliers;
    // Trials until one sample of inliers alone is found with the wanted confidence.
    const double miss = 1 - std::pow(static_cast<double>(inliers) / n, 8);
    if (miss < 1e-9) break;
    trials =
        static_cast<int>(std::min<double>(trials, std::log(1 - kConfidence) / std::log(miss) + 1));
  }
  if (best.inliers < 8) return std::nullopt;

  best.inlier.assign(static_cast<std::size_t>(n), false);
  count_inliers(best.F, x_r, x_t, max_distance_px, &best.inlier);
  for (int round = 0; round < 3; ++round) {  // local optimisation on all inliers
    std::vector<int> subset;
    for (int i = 0; i < n; ++i)
      if (best.inlier[static_cast<std::size_t>(i)]) subset.push_back(i);
    const auto F = eight_point(x_r, x_t, subset);
    if (!F) break;
    std::vector<bool> inlier(static_cast<std::size_t>(n));
    const int inliers = count_inliers(*F, x_r, x_t, max_distance_px, &inlier);
    if (inliers <= best.inliers) break;
    best = {*F, std::move(inlier), inliers};
  }
  return best;
}

std::optional<Eigen::Vector2d> undistort_pixel(const Camera& camera, const Eigen::Vector2d& pixel) {
  const auto ray = camera.unproject(pixel);
  if (!ray || ray->z() < 0.17) return std::nullopt;
  return Eigen::Vector2d(camera.fx_px * ray->x() / ray->z() + camera.cx_px,
                         camera.fy_px * ray->y() / ray->z() + camera.cy_px);
}

}  // namespace corvid
