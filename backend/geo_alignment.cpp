#include "backend/geo_alignment.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>

#include "core/alignment.h"

namespace corvid {
namespace {

constexpr std::size_t kLeastPoints = 6;
constexpr double kMaxMahalanobis2 = 16.27;  // chi-square, 3 degrees of freedom, 99.9 %
constexpr double kLeastShare = 0.5;         // of the votes must agree
constexpr int kMaxTriples = 300;

/// One finite point, whitened: W * (T p - q) has unit covariance.
struct Whitened {
  std::size_t index = 0;
  Eigen::Vector3d p, q;
  Eigen::Matrix3d W;
  double weight = 0;  // in votes: what is known well counts more; they sum up to one
};

std::vector<Whitened> whiten(std::span<const PlacedPoint> points) {
  std::vector<Whitened> out;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const PlacedPoint& point = points[i];
    if (!point.p_map.allFinite() || !point.p_enu_m.allFinite()) continue;
    const Eigen::LLT<Eigen::Matrix3d> llt(point.covariance_m2);
    const Eigen::Matrix3d W = llt.matrixL().solve(Eigen::Matrix3d::Identity());
    if (llt.info() != Eigen::Success || !W.allFinite()) continue;
    out.push_back({i, point.p_map, point.p_enu_m, W, 1 / point.covariance_m2.trace()});
  }
  double sum = 0;
  for (const Whitened& w : out) sum += w.weight;
  for (Whitened& w : out) w.weight /= sum;
  return out;
}

double mahalanobis2(const Sim3& T, const Whitened& w) {
  return (w.W * (T * w.p - w.q)).squaredNorm();
}

/// Weighted mean of truncated squared distances (MSAC, Torr and Zisserman 2000).
double score(const Sim3& T, const std::vector<Whitened>& points) {
  double sum = 0;
  for (const Whitened& w : points) sum += w.weight * std::min(kMaxMahalanobis2, mahalanobis2(T, w));
  return sum;
}

std::vector<std::size_t> agreeing(const Sim3& T, const std::vector<Whitened>& points) {
  std::vector<std::size_t> out;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (mahalanobis2(T, points[i]) < kMaxMahalanobis2) out.push_back(i);
  }
  return out;
}

std::optional<Sim3> closed_form(const std::vector<Whitened>& points,
                                const std::vector<std::size_t>& chosen) {
  std::vector<Eigen::Vector3d> p, q;
  for (const std::size_t i : chosen) {
    p.push_back(points[i].p);
    q.push_back(points[i].q);
  }
  const PointAlignment a = align_points(p, q, true);
  return a.ok() ? std::optional(a.T_target_source) : std::nullopt;
}

/// Triples with one point of each third of the path, so that they lie wide apart.
std::optional<Sim3> search(const std::vector<Whitened>& points, std::uint64_t seed,
                           const std::optional<Sim3>& guess) {
  std::mt19937_64 random(seed);
  std::optional<Sim3> best = guess;
  const std::size_t n = points.size();
  double least = guess ? score(*guess, points) : kMaxMahalanobis2;
  for (int i = 0; i < kMaxTriples; ++i) {
    // Stops as soon as another triple without an outlier is of no use (99.9 %).
    const double share = std::clamp(1 - least / kMaxMahalanobis2, 0.001, 0.999);
    if (best && i > std::log(0.001) / std::log(1 - std::pow(share, 3))) break;
    std::vector<std::size_t> triple;
    for (std::size_t third = 0; third < 3; ++third) {
      const std::size_t begin = third * n / 3, end = (third + 1) * n / 3;
      triple.push_back(begin + random() % (end - begin));
    }
    std::optional<Sim3> T = closed_form(points, triple);
    if (!T) continue;
    double s = score(*T, points);
    if (s >= least) continue;
    if (const auto refined = closed_form(points, agreeing(*T, points))) {
      if (const double r = score(*refined, points); r < s) {
        s = r;
        T = refined;
      }
    }
    least = s;
    best = T;
  }
  return best;
}

/// Normal equations of the agreeing points by the right perturbation about `centre`.
struct Normal {
  Matrix7d H = Matrix7d::Zero();
  Vector7d g = Vector7d::Zero();
};

Normal normal_equations(const Sim3& T_centred, const Eigen::Vector3d& centre,
                        const std::vector<Whitened>& points,
                        const std::vector<std::size_t>& chosen) {
  Normal normal;
  const Eigen::Matrix3d sR = T_centred.scale() * T_centred.rotation().toRotationMatrix();
  for (const std::size_t i : chosen) {
    const Whitened& w = points[i];
    const Eigen::Vector3d p = w.p - centre;
    // d(S exp(d) p) / d(d) = s R [I, -[p]x, p], docs/conventions.md.
    Eigen::Matrix<double, 3, 7> J;
    J << Eigen::Matrix3d::Identity(), -skew(p), p;
    J = w.W * sR * J;
    normal.H += J.transpose() * J;
    normal.g += J.transpose() * (w.W * (T_centred * p - w.q));
  }
  return normal;
}

/// r of (1 + r) / (1 - r): correlation of each whitened residual with the next one.
double correlation(const Sim3& T, const std::vector<Whitened>& points,
                   const std::vector<std::size_t>& chosen) {
  double products = 0, squares = 0;
  Eigen::Vector3d last = Eigen::Vector3d::Zero();
  for (const std::size_t i : chosen) {
    const Eigen::Vector3d e = points[i].W * (T * points[i].p - points[i].q);
    products += e.dot(last);
    squares += e.squaredNorm();
    last = e;
  }
  return squares > 0 ? std::clamp(products / squares, 0.0, 0.95) : 0;
}

GeoAlignment refused(GeoAlignmentStatus status, std::size_t n, std::string reason) {
  GeoAlignment out;
  out.status = status;
  out.inlier.assign(n, 0);
  out.reason = std::move(reason);
  return out;
}

/// Standard deviations of the scale and of the rotation about the worst axis.
std::pair<double, double> sigmas(const Matrix7d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(covariance.block<3, 3>(3, 3));
  return {std::sqrt(covariance(6, 6)), std::sqrt(std::max(0.0, eigen.eigenvalues()(2)))};
}

}  // namespace

GeoAlignment align_to_positions(std::span<const PlacedPoint> all,
                                const GeoAlignmentSettings& settings,
                                const std::optional<Sim3>& guess) {
  using Status = GeoAlignmentStatus;
  const std::size_t n = all.size();
  const std::vector<Whitened> points = whiten(all);
  if (points.size() < kLeastPoints) {
    return refused(
        Status::too_few, n,
        fmt::format("{} keyframes with a position, {} are needed", points.size(), kLeastPoints));
  }
  const std::optional<Sim3> start = search(points, settings.seed, guess);
  if (!start) {
    return refused(Status::too_straight, n, "the keyframes lie on one line or in one place");
  }

  // Gauss-Newton about the centre of those that agree, which change with the similarity.
  Sim3 T = *start;
  std::vector<std::size_t> chosen = agreeing(T, points);
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Normal normal;
  constexpr int kIterations = 15;
  for (int i = 0; i < kIterations && chosen.size() >= kLeastPoints; ++i) {
    centre.setZero();
    for (const std::size_t c : chosen) centre += points[c].p / static_cast<double>(chosen.size());
    const Sim3 T_centred = T * Sim3(1, Eigen::Quaterniond::Identity(), centre);
    normal = normal_equations(T_centred, centre, points, chosen);
    const Vector7d step = -normal.H.completeOrthogonalDecomposition().solve(normal.g);
    if (!step.allFinite()) break;
    T = T_centred * Sim3::exp(step) * Sim3(1, Eigen::Quaterniond::Identity(), -centre);
    std::vector<std::size_t> now = agreeing(T, points);
    const bool settled = now == chosen && normal.g.dot(-step) < 1e-9;
    chosen = std::move(now);
    if (settled) break;
  }
  double share = 0;
  for (const std::size_t c : chosen) share += points[c].weight;
  if (chosen.size() < kLeastPoints || share < kLeastShare) {
    return refused(
        Status::inconsistent, n,
        fmt::format("only {} of {} positions agree with the map", chosen.size(), points.size()));
  }

  const Eigen::SelfAdjointEigenSolver<Matrix7d> eigen(normal.H);
  if (!(eigen.eigenvalues()(0) > 1e-12 * eigen.eigenvalues()(6))) {
    return refused(Status::too_straight, n, "the keyframes lie on one line or in one place");
  }
  double squares = 0, metres2 = 0;
  for (const std::size_t c : chosen) {
    squares += mahalanobis2(T, points[c]);
    metres2 += (T * points[c].p - points[c].q).squaredNorm();
  }
  const auto count = static_cast<double>(chosen.size());
  const double r = correlation(T, points, chosen);
  const double variance = squares / (3 * count - 7);
  const double factor = std::max(1.0, variance) * (1 + r) / (1 - r);
  const Matrix7d centred = factor * normal.H.inverse();
  const auto [scale_sigma, rotation_sigma] = sigmas(centred);
  if (!(scale_sigma <= settings.max_scale_sigma)) {
    return refused(Status::too_short, n,
                   fmt::format("the path is too short for the positions' noise: scale known to "
                               "{:.2g} %, {:.2g} % are needed",
                               100 * scale_sigma, 100 * settings.max_scale_sigma));
  }
  if (!(rotation_sigma <= settings.max_rotation_sigma_rad)) {
    return refused(Status::too_straight, n,
                   fmt::format("the path is too straight for the positions' noise: rotation about "
                               "it known to {:.2g} rad, {:.2g} rad are needed",
                               rotation_sigma, settings.max_rotation_sigma_rad));
  }

  GeoAlignment out;
  out.status = Status::ok;
  out.T_enu_map = T;
  // From the centre to the map's origin: rho + [c]x phi - c sigma.
  Matrix7d Ad = Matrix7d::Identity();
  Ad.block<3, 3>(0, 3) = skew(centre);
  Ad.block<3, 1>(0, 6) = -centre;
  out.covariance = Ad * centred * Ad.transpose();
  out.inlier.assign(n, 0);
  for (const std::size_t c : chosen) out.inlier[points[c].index] = 1;
  out.inliers = static_cast<int>(chosen.size());
  out.rmse_m = std::sqrt(metres2 / count);
  out.error_factor = std::sqrt(variance);
  return out;
}

}  // namespace corvid
