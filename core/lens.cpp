#include "core/lens.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>

namespace corvid::lens {
namespace {

constexpr double kPi = std::numbers::pi;
// Pinhole and radtan end here (1e-6 rad before 90 degrees), far beyond any lens, so that nothing
// overflows.
constexpr double kMaxTangent = 1e6;
// Below it the FOV model is a pinhole to within omega^2 (x^2 + y^2) / 3 < 1e-10.
constexpr double kMinOmega_rad = 1e-5;

template <std::size_t N>
bool bernstein_positive(const std::array<double, N>& b, int depth) {
  if (!(b[0] > 0) || !(b[N - 1] > 0)) return false;
  bool all = true;
  for (const double v : b) all = all && v > 0;
  if (all) return true;
  if (depth == 0) return false;
  // De Casteljau at one half gives the coefficients on either half.
  std::array<double, N> left{}, right = b;
  for (std::size_t i = 0; i < N; ++i) {
    left[i] = right[0];
    for (std::size_t j = 0; j + 1 < N - i; ++j) right[j] = 0.5 * (right[j] + right[j + 1]);
  }
  return bernstein_positive(left, depth - 1) && bernstein_positive(right, depth - 1);
}

constexpr int kDepth = 12;

}  // namespace

bool positive_up_to(std::array<double, 4> c, double end) {
  const double c1 = c[1] * end, c2 = c[2] * end * end, c3 = c[3] * end * end * end;
  return bernstein_positive<4>(
      {c[0], c[0] + c1 / 3, c[0] + c1 * (2.0 / 3) + c2 / 3, c[0] + c1 + c2 + c3}, kDepth);
}

bool positive_up_to(std::array<double, 5> c, double end) {
  const double e2 = end * end;
  const double c1 = c[1] * end, c2 = c[2] * e2, c3 = c[3] * e2 * end, c4 = c[4] * e2 * e2;
  return bernstein_positive<5>({c[0], c[0] + c1 / 4, c[0] + c1 / 2 + c2 / 6,
                                c[0] + 0.75 * c1 + 0.5 * c2 + 0.25 * c3, c[0] + c1 + c2 + c3 + c4},
                               kDepth);
}

namespace {

// f(a) = a (1 + c0 a^2 + c1 a^4 + c2 a^6 + c3 a^8), of the radius (radtan) or the angle
// (equidistant).
using Odd = std::array<double, 4>;

double odd_value(const Odd& c, double a) {
  const double x = a * a;
  return a * (1 + x * (c[0] + x * (c[1] + x * (c[2] + x * c[3]))));
}
double odd_slope(const Odd& c, double a) {
  const double x = a * a;
  return 1 + x * (3 * c[0] + x * (5 * c[1] + x * (7 * c[2] + x * 9 * c[3])));
}
bool odd_monotonic(const Odd& c, double a) {
  return positive_up_to(std::array{1.0, 3 * c[0], 5 * c[1], 7 * c[2], 9 * c[3]}, a * a);
}

/// Solves f(a) = target for a in [0, limit] below the fold, by Newton kept in a bracket that
/// bisection halves.
bool odd_invert(const Odd& c, double target, double limit, double& a) {
  double low = 0, high = limit;
  a = std::min(target, limit);
  for (int i = 0; i < 200; ++i) {
    const bool valid = odd_monotonic(c, a);
    const double error = valid ? odd_value(c, a) - target : 0;
    if (valid && std::abs(error) <= 1e-15 * (1 + target)) return true;
    (!valid || error > 0 ? high : low) = a;
    double next = valid ? a - error / odd_slope(c, a) : low;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (next == a) break;
    a = next;
  }
  return odd_monotonic(c, a) && std::abs(odd_value(c, a) - target) <= 1e-11 * (1 + target);
}

// ---- pinhole and radtan: distortion on the plane z = 1 ----

/// Distorted (x, y) and its 2x2 Jacobian. False where the map from the centre has folded.
bool radtan(const Distortion& k, const Eigen::Vector2d& m, Eigen::Vector2d& out,
            Eigen::Matrix2d& J) {
  const auto [k1, k2, p1, p2, k3] = k;
  const double x = m.x(), y = m.y(), r2 = x * x + y * y;
  // d(r_d)/d(r) = 1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6 must not have changed its sign on the way.
  if (!positive_up_to(std::array{1.0, 3 * k1, 5 * k2, 7 * k3}, r2)) return false;
  const double radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  const double slope = k1 + r2 * (2 * k2 + r2 * 3 * k3);
  out = {x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
         y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y};
  J(0, 0) = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x;
  J(0, 1) = J(1, 0) = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y;
  J(1, 1) = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x;
  return J(0, 0) > 0 && J.determinant() > 0;  // both: the tangential part may fold, too
}

bool project_plane(const Distortion* k, const Eigen::Vector3d& p, bool with_distortion,
                   Projection& out) {
  if (!(p.z() > 0)) return false;
  const double iz = 1 / p.z(), x = p.x() * iz, y = p.y() * iz;
  Eigen::Matrix2d J = Eigen::Matrix2d::Identity();
  out.xy = {x, y};
  if (!(out.xy.squaredNorm() < kMaxTangent * kMaxTangent)) return false;
  if (k && !radtan(*k, {x, y}, out.xy, J)) return false;
  out.d_point.leftCols<2>() = J * iz;
  out.d_point.col(2) = -(J * Eigen::Vector2d(x, y)) * iz;
  if (with_distortion) {
    out.d_distortion.setZero();
    if (k) {
      const double r2 = x * x + y * y, r4 = r2 * r2, r6 = r4 * r2;
      out.d_distortion.row(0) << x * r2, x * r4, 2 * x * y, r2 + 2 * x * x, x * r6;
      out.d_distortion.row(1) << y * r2, y * r4, r2 + 2 * y * y, 2 * x * y, y * r6;
    }
  }
  return true;
}

/// The radial part alone gives the start; then Newton's method with halved steps: a step counts
/// only if it stays in the unfolded part (which holds the centre) and brings the residual down.
bool undistort_radtan(const Distortion& k, const Eigen::Vector2d& target, Eigen::Vector2d& m,
                      Eigen::Matrix2d& J) {
  const double target_radius = target.norm(), size = 1 + target_radius;
  Eigen::Vector2d value;
  m = target;
  double radius = 0;
  if (target_radius > 0 && odd_invert({k[0], k[1], k[4], 0}, target_radius, kMaxTangent, radius)) {
    m *= radius / target_radius;
  }
  for (int i = 0; !radtan(k, m, value, J); ++i) {
    if (i == 60) return false;
    m *= 0.7;
  }
  double error = (target - value).norm();
  for (int i = 0; i < 60 && error > 1e-15 * size; ++i) {
    const Eigen::Vector2d step = J.inverse() * (target - value);
    bool better = false;
    for (double share = 1; share > 1e-4 && !better; share /= 2) {
      const Eigen::Vector2d m_new = m + share * step;
      Eigen::Vector2d value_new;
      Eigen::Matrix2d J_new;
      if (!radtan(k, m_new, value_new, J_new)) continue;
      const double error_new = (target - value_new).norm();
      if (!(error_new < error)) continue;
      better = true;
      m = m_new;
      value = value_new;
      J = J_new;
      error = error_new;
    }
    if (!better) break;
  }
  return error <= 1e-11 * size;
}

bool unproject_plane(const Distortion* k, const Eigen::Vector2d& xy, Ray& out) {
  Eigen::Vector2d m = xy;
  Eigen::Matrix2d J = Eigen::Matrix2d::Identity();
  if (k && !undistort_radtan(*k, xy, m, J)) return false;
  if (!(m.squaredNorm() < kMaxTangent * kMaxTangent)) return false;
  const Eigen::Vector3d v(m.x(), m.y(), 1);
  const double n = v.norm();
  out.direction = v / n;
  const Eigen::Matrix3d tangent =
      (Eigen::Matrix3d::Identity() - out.direction * out.direction.transpose()) / n;
  out.d_xy = tangent.leftCols<2>() * J.inverse();
  return out.direction.allFinite() && out.d_xy.allFinite();
}

// ---- equidistant and FOV: the distorted radius is a function of the angle from the axis ----

bool project_radial(CameraModel model, const Distortion& k, const Eigen::Vector3d& p,
                    bool with_distortion, Projection& out) {
  const double r2 = p.x() * p.x() + p.y() * p.y(), r = std::sqrt(r2), z = p.z();
  if (!std::isfinite(r2) || !std::isfinite(z * z)) return false;
  if (!(r2 + z * z > 1e-300)) return false;  // no direction at all
  if (r == 0 && !(z > 0)) return false;      // backwards along the axis no direction is defined
  // radius = f(r, z), its derivatives, and its slope by r/z on the axis.
  double radius, by_r, by_z, on_axis = 1;
  std::array<double, 5> by_distortion{};
  if (model == CameraModel::equidistant) {
    const Odd c{k[0], k[1], k[2], k[3]};
    const double theta = std::atan2(r, z), t2 = theta * theta;
    if (!odd_monotonic(c, theta)) return false;
    radius = odd_value(c, theta);
    const double slope = odd_slope(c, theta) / (r2 + z * z);
    by_r = slope * z;
    by_z = -slope * r;
    double power = theta;
    for (std::size_t i = 0; i < 4; ++i) by_distortion[i] = power *= t2;
  } else {
    const double omega = k[0], m = 2 * std::tan(omega / 2);
    const double alpha = std::atan2(m * r, z), denominator = z * z + m * m * r2;
    radius = alpha / omega;
    by_r = m * z / (omega * denominator);
    by_z = -m * r / (omega * denominator);
    on_axis = m / omega;
    by_distortion[0] = (r * z * (1 + m * m / 4) / denominator - radius) / omega;
  }
  const Eigen::Vector2d e = r > 0 ? Eigen::Vector2d(p.head<2>() / r) : Eigen::Vector2d(1, 0);
  const double across = r > 0 ? radius / r : on_axis / z;
  out.xy = radius * e;
  out.d_point.leftCols<2>() = across * Eigen::Matrix2d::Identity();
  out.d_point.leftCols<2>() += (by_r - across) * e * e.transpose();
  out.d_point.col(2) = by_z * e;
  if (with_distortion) {
    for (int i = 0; i < 5; ++i) {
      out.d_distortion.col(i) = by_distortion[static_cast<std::size_t>(i)] * e;
    }
  }
  return true;
}

bool unproject_radial(CameraModel model, const Distortion& k, const Eigen::Vector2d& xy, Ray& out) {
  const double radius = xy.norm();
  double theta, by_radius;
  if (model == CameraModel::equidistant) {
    const Odd c{k[0], k[1], k[2], k[3]};
    if (!odd_invert(c, radius, kPi, theta)) return false;
    by_radius = 1 / odd_slope(c, theta);
  } else {
    const double omega = k[0], m = 2 * std::tan(omega / 2), alpha = omega * radius;
    if (!(alpha < kPi)) return false;
    const double s = std::sin(alpha), c = std::cos(alpha);
    theta = std::atan2(s, m * c);
    by_radius = omega * m / (s * s + m * m * c * c);
  }
  const double sine = std::sin(theta), cosine = std::cos(theta);
  const Eigen::Vector2d e = radius > 0 ? Eigen::Vector2d(xy / radius) : Eigen::Vector2d(1, 0);
  const double across = radius > 0 ? sine / radius : by_radius;
  out.direction << sine * e, cosine;
  out.d_xy.topRows<2>() = across * Eigen::Matrix2d::Identity();
  out.d_xy.topRows<2>() += (cosine * by_radius - across) * e * e.transpose();
  out.d_xy.row(2) = -sine * by_radius * e.transpose();
  return out.direction.allFinite() && out.d_xy.allFinite();
}

bool is_radial(CameraModel model, const Distortion& k) {
  return model == CameraModel::equidistant || (model == CameraModel::fov && k[0] >= kMinOmega_rad);
}

}  // namespace

bool project(CameraModel model, const Distortion& k, const Eigen::Vector3d& p,
             bool with_distortion_jacobian, Projection& out) {
  if (is_radial(model, k)) return project_radial(model, k, p, with_distortion_jacobian, out);
  const bool is_radtan = model == CameraModel::radtan;
  if (!project_plane(is_radtan ? &k : nullptr, p, with_distortion_jacobian, out)) return false;
  if (model == CameraModel::fov && with_distortion_jacobian) {
    // atan(2 r tan(omega/2)) / omega = r + omega^2 (r/12 - r^3/3) + ...
    out.d_distortion.col(0) = k[0] * (1.0 / 6 - 2.0 / 3 * out.xy.squaredNorm()) * out.xy;
  }
  return true;
}

bool unproject(CameraModel model, const Distortion& k, const Eigen::Vector2d& xy, Ray& out) {
  if (is_radial(model, k)) return unproject_radial(model, k, xy, out);
  return unproject_plane(model == CameraModel::radtan ? &k : nullptr, xy, out);
}

}  // namespace corvid::lens
