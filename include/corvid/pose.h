#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

namespace corvid {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Vector7d = Eigen::Matrix<double, 7, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

/// so(3) exponential and logarithm (rotation vector, angle in [0, pi]); exact near zero and pi.
[[nodiscard]] Eigen::Quaterniond so3_exp(const Eigen::Vector3d& phi_rad);
[[nodiscard]] Eigen::Vector3d so3_log(const Eigen::Quaterniond& q);
[[nodiscard]] Eigen::Matrix3d skew(const Eigen::Vector3d& v);
/// Right Jacobian of SO(3), exp(phi + d) ~ exp(phi) exp(Jr(phi) d), and its inverse
/// (Sola et al., "A micro Lie theory for state estimation in robotics", eqs. 143, 144).
[[nodiscard]] Eigen::Matrix3d so3_right_jacobian(const Eigen::Vector3d& phi_rad);
[[nodiscard]] Eigen::Matrix3d so3_right_jacobian_inverse(const Eigen::Vector3d& phi_rad);

/// A rigid motion. `T_a_b` takes coordinates in b to coordinates in a: p_a = T_a_b * p_b.
/// Tangent vectors are (rho [map units], phi [rad]); perturbation is on the right:
/// T (+) d = T * exp(d).
class Pose {
 public:
  Pose() = default;
  Pose(const Eigen::Quaterniond& q, const Eigen::Vector3d& t) : q_(q.normalized()), t_(t) {}
  Pose(const Eigen::Matrix3d& R, const Eigen::Vector3d& t)
      : q_(Eigen::Quaterniond(R).normalized()), t_(t) {}
  [[nodiscard]] static Pose exp(const Vector6d& tangent);
  [[nodiscard]] Vector6d log() const;

  [[nodiscard]] const Eigen::Quaterniond& rotation() const { return q_; }
  [[nodiscard]] const Eigen::Vector3d& translation() const { return t_; }
  [[nodiscard]] Eigen::Matrix3d R() const { return q_.toRotationMatrix(); }
  [[nodiscard]] Eigen::Matrix4d matrix() const;

  [[nodiscard]] Pose inverse() const {
    const Eigen::Quaterniond qi = q_.conjugate();
    return {qi, qi * -t_};
  }
  [[nodiscard]] Pose operator*(const Pose& o) const { return {q_ * o.q_, q_ * o.t_ + t_}; }
  [[nodiscard]] Eigen::Vector3d operator*(const Eigen::Vector3d& p) const { return q_ * p + t_; }
  /// T * exp(d) = exp(Ad(T) d) * T.
  [[nodiscard]] Matrix6d adjoint() const;
  [[nodiscard]] bool finite() const { return q_.coeffs().allFinite() && t_.allFinite(); }

 private:
  Eigen::Quaterniond q_ = Eigen::Quaterniond::Identity();
  Eigen::Vector3d t_ = Eigen::Vector3d::Zero();
};

/// A similarity: p_a = s R p_b + t. Tangent (rho, phi, sigma = log s), perturbation on the right.
class Sim3 {
 public:
  Sim3() = default;
  Sim3(double scale, const Eigen::Quaterniond& q, const Eigen::Vector3d& t)
      : s_(scale), q_(q.normalized()), t_(t) {}
  [[nodiscard]] static Sim3 exp(const Vector7d& tangent);
  [[nodiscard]] Vector7d log() const;

  [[nodiscard]] double scale() const { return s_; }
  [[nodiscard]] const Eigen::Quaterniond& rotation() const { return q_; }
  [[nodiscard]] const Eigen::Vector3d& translation() const { return t_; }
  [[nodiscard]] Sim3 inverse() const {
    const Eigen::Quaterniond qi = q_.conjugate();
    return {1.0 / s_, qi, qi * t_ * (-1.0 / s_)};
  }
  [[nodiscard]] Sim3 operator*(const Sim3& o) const {
    return {s_ * o.s_, q_ * o.q_, s_ * (q_ * o.t_) + t_};
  }
  [[nodiscard]] Eigen::Vector3d operator*(const Eigen::Vector3d& p) const {
    return s_ * (q_ * p) + t_;
  }
  /// The camera pose seen from the other side: rotation composed, position mapped, scale dropped.
  [[nodiscard]] Pose operator*(const Pose& T) const {
    return {q_ * T.rotation(), *this * T.translation()};
  }

 private:
  double s_ = 1;
  Eigen::Quaterniond q_ = Eigen::Quaterniond::Identity();
  Eigen::Vector3d t_ = Eigen::Vector3d::Zero();
};

struct StampedPose {
  std::int64_t time_ns = 0;
  Pose T_world_camera;
};
/// Ordered by time.
using Trajectory = std::vector<StampedPose>;

}  // namespace corvid
