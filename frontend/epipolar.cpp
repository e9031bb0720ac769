#include "frontend/epipolar.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <random>

#include "corvid/pose.h"

namespace corvid {
namespace {

using Points = std::span<const Eigen::Vector2d>;
using Vector9d = Eigen::Matrix<double, 9, 1>;
using Matrix9d = Eigen::Matrix<double, 9, 9>;
using RowMajor3d = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

/// Centred coordinates of both images in one scale, so that Sampson distances are scaled by `scale`
/// and nothing else; in a random order.
struct Normalized {
  std::vector<Eigen::Vector2d> r, t;
  std::vector<float> x_r, y_r, x_t, y_t;  ///< the same, for loops over many
  double scale = 1;
  Eigen::Matrix3d T_r, T_t;  ///< pixels -> normalized

  [[nodiscard]] std::size_t size() const { return r.size(); }
  [[nodiscard]] Eigen::Matrix3d to_pixels(const Eigen::Matrix3d& F) const {
    const Eigen::Matrix3d pixels = T_t.transpose() * F * T_r;
    return pixels / pixels.norm();
  }
  [[nodiscard]] Eigen::Matrix3d from_pixels(const Eigen::Matrix3d& F) const {
    const Eigen::Matrix3d G = T_t.transpose().inverse() * F * T_r.inverse();
    return G / G.norm();
  }
};

/// Nothing where points are not finite or too far apart for numbers.
std::optional<Normalized> normalize(Points x_r, Points x_t, std::span<const int> order) {
  Normalized n;
  const auto count = static_cast<double>(x_r.size());
  const Eigen::Vector2d zero = Eigen::Vector2d::Zero();
  const Eigen::Vector2d mean_r = std::accumulate(x_r.begin(), x_r.end(), zero) / count;
  const Eigen::Vector2d mean_t = std::accumulate(x_t.begin(), x_t.end(), zero) / count;
  double distance = 0;
  for (std::size_t i = 0; i < x_r.size(); ++i)
    distance += ((x_r[i] - mean_r).norm() + (x_t[i] - mean_t).norm()) / (2 * count);
  if (!(distance < 1e9)) return std::nullopt;
  n.scale = distance > 1e-9 ? std::sqrt(2.0) / distance : 1.0;
  n.T_r << n.scale, 0, -n.scale * mean_r.x(), 0, n.scale, -n.scale * mean_r.y(), 0, 0, 1;
  n.T_t << n.scale, 0, -n.scale * mean_t.x(), 0, n.scale, -n.scale * mean_t.y(), 0, 0, 1;
  for (int k : order) {
    const auto i = static_cast<std::size_t>(k);
    n.r.push_back(n.scale * (x_r[i] - mean_r));
    n.t.push_back(n.scale * (x_t[i] - mean_t));
    n.x_r.push_back(static_cast<float>(n.r.back().x()));
    n.y_r.push_back(static_cast<float>(n.r.back().y()));
    n.x_t.push_back(static_cast<float>(n.t.back().x()));
    n.y_t.push_back(static_cast<float>(n.t.back().y()));
  }
  return n;
}

/// A row of the system A f = 0, f the rows of F one after the other.
Vector9d constraint(const Eigen::Vector2d& r, const Eigen::Vector2d& t) {
  Vector9d row;
  row << t.x() * r.x(), t.x() * r.y(), t.x(), t.y() * r.x(), t.y() * r.y(), t.y(), r.x(), r.y(), 1;
  return row;
}

Eigen::Matrix3d as_matrix(const Vector9d& f) { return Eigen::Map<const RowMajor3d>(f.data()); }

/// The null vector of a sample's system: the last column of Q in A^T = Q R. Rank 3, mostly.
Eigen::Matrix3d eight_point(const Normalized& n, std::span<const int> sample) {
  Eigen::Matrix<double, 9, 8> A_transposed;
  for (int k = 0; k < 8; ++k) {
    const auto i = static_cast<std::size_t>(sample[static_cast<std::size_t>(k)]);
    A_transposed.col(k) = constraint(n.r[i], n.t[i]);
  }
  const Eigen::HouseholderQR<Eigen::Matrix<double, 9, 8>> qr(A_transposed);
  Vector9d f = Vector9d::Unit(8);
  f.applyOnTheLeft(qr.householderQ());
  return as_matrix(f);
}

/// The nearest matrix of rank 2; its factors span the tangent space that refinement moves in.
struct RankTwo {
  Eigen::Matrix3d U, V;
  Eigen::Vector2d sigma;  ///< unit length
  explicit RankTwo(const Eigen::Matrix3d& F) {
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV);
    U = svd.matrixU();
    V = svd.matrixV();
    sigma = svd.singularValues().head<2>().normalized();
  }
  [[nodiscard]] Eigen::Matrix3d matrix() const {
    return U.leftCols<2>() * sigma.asDiagonal() * V.leftCols<2>().transpose();
  }
};

/// Residual and gradient of one correspondence, for one number or several at once.
template <typename T>
T one_minus_squared_distance(const Eigen::Matrix3f& F, float over_tau2, const T& x_r, const T& y_r,
                             const T& x_t, const T& y_t) {
  const T a = F(0, 0) * x_r + F(0, 1) * y_r + F(0, 2), b = F(1, 0) * x_r + F(1, 1) * y_r + F(1, 2),
          c = F(2, 0) * x_r + F(2, 1) * y_r + F(2, 2), d = F(0, 0) * x_t + F(1, 0) * y_t + F(2, 0),
          e = F(0, 1) * x_t + F(1, 1) * y_t + F(2, 1), n = x_t * a + y_t * b + c;
  return 1.0F - n * n * over_tau2 / (a * a + b * b + d * d + e * e + 1e-30F);
}

/// MSAC: the sum of 1 - (d / tau)^2 over the correspondences first .. end - 1 that have d < tau.
float score(const Eigen::Matrix3d& F, const Normalized& n, std::size_t first, std::size_t end,
            double tau) {
  using Packet = Eigen::Array<float, 16, 1>;
  const Eigen::Matrix3f f = F.cast<float>();
  const auto over_tau2 = static_cast<float>(1 / (tau * tau));
  Packet sum = Packet::Zero();
  std::size_t i = first;
  for (; i + 16 <= end; i += 16) {
    const auto at = [i](const std::vector<float>& v) {
      return Packet(Eigen::Map<const Packet>(v.data() + i));
    };
    sum +=
        one_minus_squared_distance<Packet>(f, over_tau2, at(n.x_r), at(n.y_r), at(n.x_t), at(n.y_t))
            .max(0.0F);
  }
  float total = sum.sum();
  for (; i < end; ++i)
    total += std::max(0.0F, one_minus_squared_distance<float>(f, over_tau2, n.x_r[i], n.y_r[i],
                                                              n.x_t[i], n.y_t[i]));
  return total;
}

double share_within(const Eigen::Matrix3d& F, const Normalized& n, std::size_t count, double tau) {
  std::size_t within = 0;
  for (std::size_t i = 0; i < count; ++i) within += sampson_distance_px(F, n.r[i], n.t[i]) <= tau;
  return static_cast<double>(within) / static_cast<double>(count);
}

/// Least squares over the correspondences nearer than `tau`, each weighted by its gradient, so that
/// what is minimised is nearly the Sampson distance.
Eigen::Matrix3d least_squares(const Eigen::Matrix3d& F, const Normalized& n, std::size_t count,
                              double tau) {
  Matrix9d normal = Matrix9d::Zero();
  for (std::size_t i = 0; i < count; ++i) {
    const double g = (F * n.r[i].homogeneous()).head<2>().squaredNorm() +
                     (F.transpose() * n.t[i].homogeneous()).head<2>().squaredNorm() + 1e-30;
    const Vector9d row = constraint(n.r[i], n.t[i]);
    const double e = n.t[i].homogeneous().dot(F * n.r[i].homogeneous());
    if (e * e > tau * tau * g) continue;
    normal.selfadjointView<Eigen::Lower>().rankUpdate(row, 1 / (g + 1e-12));
  }
  const Eigen::SelfAdjointEigenSolver<Matrix9d> solver(normal);
  return RankTwo(as_matrix(solver.eigenvectors().col(0))).matrix();
}

/// Sum of Tukey's biweight loss over all correspondences, in units of its limit; with `system`, the
/// normal equations of its weighted residuals by the nine elements of F, too.
struct NormalEquations {
  Matrix9d A = Matrix9d::Zero();
  Vector9d b = Vector9d::Zero();
};
double tukey_loss(const Eigen::Matrix3d& F, const Normalized& n, double limit,
                  NormalEquations* system) {
  double loss = 0;
  for (std::size_t i = 0; i < n.size(); ++i) {
    const Eigen::Vector3d r = n.r[i].homogeneous(), t = n.t[i].homogeneous();
    const Eigen::Vector3d l = F * r, m = F.transpose() * t;
    const double g = l.head<2>().squaredNorm() + m.head<2>().squaredNorm() + 1e-30;
    const double s = std::sqrt(g), e = t.dot(l) / s, u = 1 - e * e / (limit * limit);
    loss += u > 0 ? 1 - u * u * u : 1;
    if (!system || u <= 0) continue;
    // e = n / sqrt(g): de = dn / sqrt(g) - e dg / (2 g).
    Eigen::Matrix3d J = t * r.transpose();
    const double q = e / s;
    J.row(0) -= q * l.x() * r.transpose();
    J.row(1) -= q * l.y() * r.transpose();
    J.col(0) -= q * m.x() * t;
    J.col(1) -= q * m.y() * t;
    const RowMajor3d rows = J / s;
    const Vector9d j = Eigen::Map<const Vector9d>(rows.data());
    const double weight = u * u;
    system->A.selfadjointView<Eigen::Lower>().rankUpdate(j, weight);
    system->b -= weight * e * j;
  }
  return loss;
}

/// Levenberg-Marquardt from `start`: no worse under Tukey's loss with that limit.
Eigen::Matrix3d refine_within(const Eigen::Matrix3d& start, const Normalized& n, double limit) {
  constexpr int kIterations = 12;
  RankTwo now(start);
  double loss = tukey_loss(now.matrix(), n, limit, nullptr), damping = 1e-9;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    NormalEquations all;
    tukey_loss(now.matrix(), n, limit, &all);
    all.A = all.A.selfadjointView<Eigen::Lower>();
    // The seven directions in which a matrix of rank 2 and unit norm moves: U and V turn, and the
    // singular values on their circle.
    Eigen::Matrix<double, 9, 7> basis;
    const Eigen::Matrix3d S = Eigen::Vector3d(now.sigma.x(), now.sigma.y(), 0).asDiagonal();
    const auto set = [&](int k, const Eigen::Matrix3d& inner) {
      const RowMajor3d d = now.U * inner * now.V.transpose();
      basis.col(k) = Eigen::Map<const Vector9d>(d.data());
    };
    for (int k = 0; k < 3; ++k) {
      set(k, skew(Eigen::Vector3d::Unit(k)) * S);
      set(3 + k, S * skew(Eigen::Vector3d::Unit(k)).transpose());
    }
    set(6, Eigen::Vector3d(-now.sigma.y(), now.sigma.x(), 0).asDiagonal());
    const Eigen::Matrix<double, 7, 7> A = basis.transpose() * all.A * basis;
    const Eigen::Matrix<double, 7, 1> b = basis.transpose() * all.b;
    const double level = A.trace() / 7 + 1e-300;
    bool better = false;
    double gain = 0;
    for (; !better && damping < 1e3; damping *= better ? 0.01 : 100) {
      const Eigen::Matrix<double, 7, 7> damped =
          A + damping * level * Eigen::Matrix<double, 7, 7>::Identity();
      const Eigen::Matrix<double, 7, 1> step = damped.ldlt().solve(b);
      RankTwo next = now;
      next.U = now.U * so3_exp(step.head<3>()).matrix();
      next.V = now.V * so3_exp(step.segment<3>(3)).matrix();
      const double c = std::cos(step(6)), s = std::sin(step(6));
      next.sigma = {c * now.sigma.x() - s * now.sigma.y(), s * now.sigma.x() + c * now.sigma.y()};
      const double next_loss = tukey_loss(next.matrix(), n, limit, nullptr);
      better = next_loss < loss;
      if (!better) continue;
      gain = loss - next_loss;
      loss = next_loss;
      now = next;
    }
    if (!better || gain < 1e-6 * loss) break;
  }
  return now.matrix();
}

/// First with a wide limit, which lets F move; then with the one that suits the noise of those that
/// agree (4.7 deviations, 7 medians of the distance), which lets go of outliers.
Eigen::Matrix3d refine(const Eigen::Matrix3d& start, const Normalized& n, double tau) {
  const Eigen::Matrix3d F = refine_within(start, n, 3 * tau);
  std::vector<double> agreeing;
  for (std::size_t i = 0; i < n.size(); ++i)
    if (const double d = sampson_distance_px(F, n.r[i], n.t[i]); d < 3 * tau) agreeing.push_back(d);
  if (agreeing.empty()) return F;
  const auto middle = agreeing.begin() + static_cast<std::ptrdiff_t>(agreeing.size() / 2);
  std::nth_element(agreeing.begin(), middle, agreeing.end());
  return refine_within(F, n, std::clamp(7 * *middle, 0.5 * tau, 3 * tau));
}

/// RANSAC: a start for refine().
Eigen::Matrix3d search(const Normalized& n, double tau, std::mt19937_64& random,
                       const std::optional<Eigen::Matrix3d>& start) {
  constexpr double kMaxTrials = 10000, kMinTrials = 40, kConfidence = 0.999;
  // A sample's F is off by the noise of eight points: it is judged more widely than the result.
  const double wide = 2 * tau;
  const std::size_t judges = std::min<std::size_t>(n.size(), 1000);
  // Of many, the first quarter tells a hopeless trial: three deviations below the best.
  const std::size_t quarter = judges < 400 ? 0 : judges / 4;
  Eigen::Matrix3d best = start ? *start : Eigen::Matrix3d(Eigen::Matrix3d::Zero());
  float best_score = start ? score(best, n, 0, judges, wide) : -1.0F;
  std::vector<int> order(n.size());
  std::iota(order.begin(), order.end(), 0);
  double trials = kMaxTrials;
  for (int trial = 0; trial < trials; ++trial) {
    for (std::size_t k = 0; k < 8; ++k)  // partial Fisher-Yates; the modulo's bias is below 1e-12
      std::swap(order[k], order[k + random() % (order.size() - k)]);
    const Eigen::Matrix3d F = eight_point(n, std::span(order).first<8>());
    float found = score(F, n, 0, quarter, wide);
    if (4 * found < 0.75F * best_score && quarter > 0) continue;
    found += score(F, n, quarter, judges, wide);
    if (found <= best_score) continue;
    best = F;
    best_score = found;
    Eigen::Matrix3d optimised = F;
    for (double widening : {2.0, 1.5, 1.0}) {
      optimised = least_squares(optimised, n, judges, widening * wide);
      const float optimised_score = score(optimised, n, 0, judges, wide);
      if (optimised_score <= best_score) continue;
      best = optimised;
      best_score = optimised_score;
    }
    // Trials until one sample of inliers alone is found with the wanted confidence.
    const double hit = std::pow(share_within(best, n, judges, wide), 8);
    trials = std::clamp(std::log(1 - kConfidence) / std::log1p(-hit) + 1, kMinTrials, trials);
  }
  return best;
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
                                                     std::uint64_t seed,
                                                     const std::optional<Eigen::Matrix3d>& start) {
  if (x_r.size() < 8 || x_t.size() != x_r.size()) return std::nullopt;
  std::mt19937_64 random(seed);
  std::vector<int> order(x_r.size());
  std::iota(order.begin(), order.end(), 0);
  for (std::size_t k = order.size(); k > 1; --k) std::swap(order[k - 1], order[random() % k]);
  const auto n = normalize(x_r, x_t, order);
  if (!n) return std::nullopt;
  const double tau = max_distance_px * n->scale;

  EpipolarGeometry geometry;
  const auto judge = [&](const Eigen::Matrix3d& F) {
    geometry = {n->to_pixels(F), std::vector<bool>(x_r.size()), 0};
    for (std::size_t i = 0; i < x_r.size(); ++i) {
      geometry.inlier[i] = sampson_distance_px(geometry.F, x_r[i], x_t[i]) <= max_distance_px;
      geometry.inliers += geometry.inlier[i];
    }
  };
  std::optional<Eigen::Matrix3d> first;
  if (start && start->allFinite() && start->norm() > 1e-300) {
    first = refine(n->from_pixels(*start), *n, tau);
    judge(*first);
  }
  if (2 * static_cast<std::size_t>(geometry.inliers) < x_r.size())
    judge(refine(search(*n, tau, random, first), *n, tau));
  if (geometry.inliers < 8 || !geometry.F.allFinite()) return std::nullopt;
  return geometry;
}

std::optional<Eigen::Vector2d> undistort_pixel(const Camera& camera, const Eigen::Vector2d& pixel) {
  const auto ray = camera.unproject(pixel);
  if (!ray || ray->z() < 0.17) return std::nullopt;
  return Eigen::Vector2d(camera.fx_px * ray->x() / ray->z() + camera.cx_px,
                         camera.fy_px * ray->y() / ray->z() + camera.cy_px);
}

}  // namespace corvid
