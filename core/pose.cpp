#include "corvid/pose.h"

#include <Eigen/LU>
#include <cmath>

namespace corvid {
namespace {

// Below this angle the Taylor series (error of order angle^4 / 1000) beat the closed forms.
constexpr double kSmallAngle = 1e-3;

/// W(Z) = sum Z^n / (n+1)! = integral of exp(u Z) du over [0, 1], for Z = sigma I + [phi]x: the
/// matrix that takes rho to the translation of the similarity (Eade, "Lie groups for 2D and 3D
/// transformations", 6.2). The closed form cancels where sigma or phi is small; scaling by halves
/// and doubling, W(2Z) = (exp(Z) + I) W(Z) / 2, does not.
Eigen::Matrix3d similarity_v(const Eigen::Vector3d& phi, double sigma) {
  const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d Z = skew(phi) + sigma * I;
  int halvings = 0;
  for (double size = Z.cwiseAbs().rowwise().sum().maxCoeff(); size > 0.25 && halvings < 64;
       size /= 2) {
    ++halvings;
  }
  Z *= std::ldexp(1.0, -halvings);
  Eigen::Matrix3d W = I;
  for (int n = 12; n >= 1; --n) W = (I + Z * W / (n + 1)).eval();  // Horner's scheme
  Eigen::Matrix3d exp_Z = I + Z * W;
  for (int i = 0; i < halvings; ++i) {
    W = (0.5 * (exp_Z + I) * W).eval();
    exp_Z = (exp_Z * exp_Z).eval();
  }
  return W;
}

}  // namespace

Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Eigen::Quaterniond so3_exp(const Eigen::Vector3d& phi_rad) {
  const double angle = phi_rad.norm();
  const double scale =
      angle < kSmallAngle ? 0.5 - angle * angle / 48 : std::sin(0.5 * angle) / angle;
  const Eigen::Vector3d v = scale * phi_rad;
  return Eigen::Quaterniond(std::cos(0.5 * angle), v.x(), v.y(), v.z()).normalized();
}

Eigen::Vector3d so3_log(const Eigen::Quaterniond& q) {
  // q and -q are one rotation: the one with w >= 0 has its angle in [0, pi].
  const double sign = q.w() < 0 ? -1.0 : 1.0;
  const Eigen::Vector3d v = sign * q.vec();
  const double w = sign * q.w();
  const double n = v.norm();
  if (n < kSmallAngle * w) {
    const double t = n / w;
    return v * (2 / w * (1 - t * t / 3 + t * t * t * t / 5));
  }
  return v * (2 * std::atan2(n, w) / n);
}

Eigen::Matrix3d so3_right_jacobian(const Eigen::Vector3d& phi_rad) {
  const double angle = phi_rad.norm();
  const double a2 = angle * angle;
  const Eigen::Matrix3d S = skew(phi_rad);
  double first, second;
  if (angle < kSmallAngle) {
    first = 0.5 - a2 / 24;
    second = 1.0 / 6 - a2 / 120;
  } else {
    const double half_sin = std::sin(0.5 * angle);
    first = 2 * half_sin * half_sin / a2;
    second = (angle - std::sin(angle)) / (a2 * angle);
  }
  return Eigen::Matrix3d::Identity() - first * S + second * S * S;
}

Eigen::Matrix3d so3_right_jacobian_inverse(const Eigen::Vector3d& phi_rad) {
  const double angle = phi_rad.norm();
  const double a2 = angle * angle;
  const Eigen::Matrix3d S = skew(phi_rad);
  // (1 + cos) / sin = cot(angle / 2), which is harmless at pi.
  const double second = angle < 1e-2 ? 1.0 / 12 + a2 / 720 + a2 * a2 / 30240
                                     : (1 - 0.5 * angle / std::tan(0.5 * angle)) / a2;
  return Eigen::Matrix3d::Identity() + 0.5 * S + second * S * S;
}

Pose Pose::exp(const Vector6d& tangent) {
  const Eigen::Vector3d phi = tangent.tail<3>();
  // The left Jacobian at phi is the right one at -phi.
  return {so3_exp(phi), so3_right_jacobian(-phi) * tangent.head<3>()};
}

Vector6d Pose::log() const {
  Vector6d tangent;
  const Eigen::Vector3d phi = so3_log(q_);
  tangent << so3_right_jacobian_inverse(-phi) * t_, phi;
  return tangent;
}

Eigen::Matrix4d Pose::matrix() const {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.topLeftCorner<3, 3>() = R();
  m.topRightCorner<3, 1>() = t_;
  return m;
}

Matrix6d Pose::adjoint() const {
  Matrix6d m = Matrix6d::Zero();
  const Eigen::Matrix3d rotation = R();
  m.topLeftCorner<3, 3>() = rotation;
  m.bottomRightCorner<3, 3>() = rotation;
  m.topRightCorner<3, 3>() = skew(t_) * rotation;
  return m;
}

Sim3 Sim3::exp(const Vector7d& tangent) {
  const Eigen::Vector3d phi = tangent.segment<3>(3);
  const double sigma = tangent[6];
  return {std::exp(sigma), so3_exp(phi), similarity_v(phi, sigma) * tangent.head<3>()};
}

Vector7d Sim3::log() const {
  Vector7d tangent;
  const Eigen::Vector3d phi = so3_log(q_);
  const double sigma = std::log(s_);
  tangent << similarity_v(phi, sigma).partialPivLu().solve(t_), phi, sigma;
  return tangent;
}

}  // namespace corvid
