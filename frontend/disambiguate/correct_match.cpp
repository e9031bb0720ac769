#include "frontend/disambiguate/correct_match.h"

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

namespace corvid {
namespace {

/// Coefficients, lowest power first.
template <std::size_t A, std::size_t B>
std::array<double, A + B - 1> product(const std::array<double, A>& a,
                                      const std::array<double, B>& b) {
  std::array<double, A + B - 1> c{};
  for (std::size_t i = 0; i < A; ++i)
    for (std::size_t j = 0; j < B; ++j) c[i + j] += a[i] * b[j];
  return c;
}

/// Real parts of all roots: the real ones are among them, and so are double roots that rounding has
/// made complex. Each is improved by Newton steps.
std::vector<double> root_candidates(const std::array<double, 7>& g) {
  double largest = 0;
  for (double c : g) largest = std::max(largest, std::abs(c));
  int degree = 6;
  while (degree > 0 && std::abs(g[static_cast<std::size_t>(degree)]) <= 1e-14 * largest) --degree;
  if (degree == 0) return {};
  Eigen::MatrixXd companion = Eigen::MatrixXd::Zero(degree, degree);
  companion.diagonal(-1).setOnes();
  for (int k = 0; k < degree; ++k)
    companion(k, degree - 1) =
        -g[static_cast<std::size_t>(k)] / g[static_cast<std::size_t>(degree)];
  if (!companion.allFinite()) return {};
  std::vector<double> roots;
  for (const std::complex<double>& root : companion.eigenvalues()) {
    double t = root.real();
    for (int step = 0; step < 3; ++step) {
      double value = 0, slope = 0;
      for (std::size_t k = g.size(); k-- > 0;) {
        slope = slope * t + value;
        value = value * t + g[k];
      }
      const double next = t - value / slope;
      if (!std::isfinite(next)) break;
      t = next;
    }
    roots.push_back(root.real());
    roots.push_back(t);
  }
  return roots;
}

/// The point of a line nearest to the origin, homogeneous.
Eigen::Vector3d nearest_to_origin(const Eigen::Vector3d& line) {
  return {-line.x() * line.z(), -line.y() * line.z(), line.head<2>().squaredNorm()};
}

/// Turns (x, y) of an epipole to (|.|, 0).
Eigen::Matrix3d turning(const Eigen::Vector3d& epipole) {
  Eigen::Matrix3d R;
  R << epipole.x(), epipole.y(), 0, -epipole.y(), epipole.x(), 0, 0, 0, 1;
  return R;
}

}  // namespace

std::pair<Eigen::Vector2d, Eigen::Vector2d> correct_match(const Eigen::Matrix3d& F,
                                                          const Eigen::Vector2d& x_r,
                                                          const Eigen::Vector2d& x_t) {
  const std::pair<Eigen::Vector2d, Eigen::Vector2d> unchanged{x_r, x_t};
  // Both points to the origin.
  Eigen::Matrix3d to_r = Eigen::Matrix3d::Identity(), to_t = to_r;
  to_r.topRightCorner<2, 1>() = x_r;
  to_t.topRightCorner<2, 1>() = x_t;
  Eigen::Matrix3d G = to_t.transpose() * F * to_r;
  const double norm = G.norm();
  if (!G.allFinite() || !(norm > 1e-300) || G(2, 2) == 0) return unchanged;
  G /= norm;
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(G, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d e_r = svd.matrixV().col(2), e_t = svd.matrixU().col(2);
  const double far_r = e_r.head<2>().norm(), far_t = e_t.head<2>().norm();
  // A point that is its epipole satisfies F with any other.
  if (!(far_r > 1e-12) || !(far_t > 1e-12)) return unchanged;
  e_r /= far_r;
  e_t /= far_t;
  const Eigen::Matrix3d R_r = turning(e_r), R_t = turning(e_t);
  G = R_t * G * R_r.transpose();
  const double f = e_r.z(), h = e_t.z();
  const double a = G(1, 1), b = G(1, 2), c = G(2, 1), d = G(2, 2);
  // The lines of the reference pass (0, t, 1) and the epipole (1, 0, f); a line's distance from the
  // origin, squared, and that of its partner in the target:
  const auto cost = [&](double t) {
    const double p = a * t + b, q = c * t + d;
    return t * t / (1 + f * f * t * t) + q * q / (p * p + h * h * q * q);
  };
  // Half the derivative's numerator.
  const std::array<double, 2> p{b, a}, q{d, c};
  const auto pp = product(p, p), qq = product(q, q);
  const std::array<double, 3> inner{pp[0] + h * h * qq[0], pp[1] + h * h * qq[1],
                                    pp[2] + h * h * qq[2]};
  const auto first = product(std::array<double, 2>{0, 1}, product(inner, inner));
  const std::array<double, 3> outer{1, 0, f * f};
  const auto second = product(product(outer, outer), product(p, q));
  std::array<double, 7> g{};
  for (std::size_t k = 0; k < 6; ++k) g[k] = first[k];
  for (std::size_t k = 0; k < 7; ++k) g[k] -= (a * d - b * c) * second[k];

  // At infinity: the line (f, 1, 0)^ of the reference, which passes the epipole and (0, 1, 0).
  double least = std::numeric_limits<double>::infinity();
  Eigen::Vector3d line_r = Eigen::Vector3d::Zero(), line_t = line_r;
  if (f != 0) {
    least = 1 / (f * f) + c * c / (a * a + h * h * c * c);
    line_r = {f, 0, -1};
    line_t = {-h * c, a, c};
  }
  for (double t : root_candidates(g)) {
    const double found = cost(t);
    if (!(found < least)) continue;
    least = found;
    line_r = {t * f, 1, -t};
    line_t = {-h * (c * t + d), a * t + b, c * t + d};
  }
  const Eigen::Vector3d near_r = to_r * R_r.transpose() * nearest_to_origin(line_r);
  const Eigen::Vector3d near_t = to_t * R_t.transpose() * nearest_to_origin(line_t);
  const std::pair<Eigen::Vector2d, Eigen::Vector2d> corrected{near_r.hnormalized(),
                                                              near_t.hnormalized()};
  return corrected.first.allFinite() && corrected.second.allFinite() ? corrected : unchanged;
}

}  // namespace corvid
