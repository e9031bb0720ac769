#include "frontend/disambiguate/affine_transfer.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <random>
#include <vector>

#include "core/check.h"
#include "frontend/disambiguate/ratio_inequalities.h"

namespace corvid {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;  ///< x_r, x_a, x_t of one point

Vector6d column(const Triplet& triplet) {
  return (Vector6d() << triplet.x_r, triplet.x_a, triplet.x_t).finished();
}

/// Factorization: the measurements' principal directions are the cameras, scaled so that structure
/// has unit variance: elements in pixels.
AffineTransfer factorize(std::span<const Triplet> triplets, std::span<const int> subset) {
  Vector6d mean = Vector6d::Zero();
  for (int i : subset) mean += column(triplets[static_cast<std::size_t>(i)]);
  mean /= static_cast<double>(subset.size());
  Eigen::Matrix<double, 6, 6> scatter = Eigen::Matrix<double, 6, 6>::Zero();
  for (int i : subset) {
    const Vector6d centred = column(triplets[static_cast<std::size_t>(i)]) - mean;
    scatter += centred * centred.transpose() / static_cast<double>(subset.size());
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>> solver(scatter);
  const Eigen::Matrix<double, 6, 3> cameras =
      solver.eigenvectors().rightCols<3>() *
      solver.eigenvalues().tail<3>().cwiseMax(0).cwiseSqrt().asDiagonal();
  constexpr double kLeastPx = 0.5;
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(cameras.topRows<4>(),
                                              Eigen::ComputeThinU | Eigen::ComputeThinV);
  Eigen::Vector3d inverse = Eigen::Vector3d::Zero();
  for (int k = 0; k < 3; ++k)
    if (svd.singularValues()(k) > kLeastPx) inverse(k) = 1 / svd.singularValues()(k);
  AffineTransfer transfer;
  transfer.linear =
      cameras.bottomRows<2>() * svd.matrixV() * inverse.asDiagonal() * svd.matrixU().transpose();
  transfer.offset = mean.tail<2>() - transfer.linear * mean.head<4>();
  return transfer;
}

/// Inliers, in order; their number and largest error in `transfer`.
std::vector<int> judge(std::span<const Triplet> triplets, double max_px, AffineTransfer& transfer) {
  std::vector<int> inliers;
  transfer.largest_error_px = 0;
  for (std::size_t i = 0; i < triplets.size(); ++i) {
    const double error_px = (transfer(triplets[i].x_r, triplets[i].x_a) - triplets[i].x_t).norm();
    if (!(error_px <= max_px)) continue;
    inliers.push_back(static_cast<int>(i));
    transfer.largest_error_px = std::max(transfer.largest_error_px, error_px);
  }
  transfer.inliers = static_cast<int>(inliers.size());
  return inliers;
}

}  // namespace

std::optional<AffineTransfer> estimate_affine_transfer(std::span<const Triplet> triplets,
                                                       double max_px, int min_inliers,
                                                       std::uint64_t seed) {
  constexpr double kMaxTrials = 200, kConfidence = 0.999;
  if (triplets.size() < 4) return std::nullopt;
  std::mt19937_64 random(seed);
  std::vector<int> order(triplets.size());
  std::iota(order.begin(), order.end(), 0);
  AffineTransfer best;
  double trials = kMaxTrials;
  for (int trial = 0; trial < trials; ++trial) {
    for (std::size_t k = 0; k < 4; ++k)
      std::swap(order[k], order[k + random() % (order.size() - k)]);
    AffineTransfer transfer = factorize(triplets, std::span(order).first<4>());
    // Over its inliers, twice: four points are no more than a beginning.
    for (int round = 0; round < 3; ++round) {
      const std::vector<int> inliers = judge(triplets, max_px, transfer);
      if (transfer.inliers > best.inliers) best = transfer;
      if (round == 2 || transfer.inliers <= 4 || 2 * transfer.inliers < best.inliers) break;
      transfer = factorize(triplets, inliers);
    }
    const double share = static_cast<double>(best.inliers) / static_cast<double>(triplets.size());
    trials = std::min(trials, std::log(1 - kConfidence) / std::log1p(-std::pow(share, 4)) + 1);
  }
  if (best.inliers < min_inliers || 2 * static_cast<std::size_t>(best.inliers) < triplets.size())
    return std::nullopt;
  return best;
}

ModuleCounts accept_affine_transfer(MatchSets& sets, const AuxiliaryView& auxiliary,
                                    const DisambiguationOptions& options) {
  CORVID_CHECK(auxiliary.x_a.size() == sets.points.size(), "one x_a per point");
  ModuleCounts counts;
  std::vector<Triplet> triplets;
  bool wanted = false;
  for (std::size_t i = 0; i < sets.points.size(); ++i) {
    const MatchSets::Point& point = sets.points[i];
    const auto& x_a = auxiliary.x_a[i];
    if (!x_a) continue;
    if (point.accepted) triplets.push_back({point.x_r, *x_a, point.match()});
    wanted = wanted || point.in_m();
  }
  if (!wanted) return counts;
  const auto transfer =
      estimate_affine_transfer(triplets, options.affine_px, options.min_matches, options.seed);
  if (!transfer) return counts;
  std::vector<double> distances_px;
  for (std::size_t i = 0; i < sets.points.size(); ++i) {
    MatchSets::Point& point = sets.points[i];
    if (!point.in_m() || !auxiliary.x_a[i]) continue;
    ++counts.in;
    const Eigen::Vector2d expected = (*transfer)(point.x_r, *auxiliary.x_a[i]);
    distances_px.clear();
    for (const Eigen::Vector2d& x_t : point.x_t) distances_px.push_back((x_t - expected).norm());
    point.accepted = ratio_inequalities(distances_px, options.ratio, transfer->largest_error_px);
    counts.accepted += point.accepted.has_value();
  }
  return counts;
}

}  // namespace corvid
