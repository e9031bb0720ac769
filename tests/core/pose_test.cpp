#include "corvid/pose.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <numbers>
#include <unsupported/Eigen/MatrixFunctions>

#include "oracle/finite_difference.h"

namespace corvid {
namespace {

using test::finite_difference;
using test::random_rotation;
using test::random_vector;
constexpr double kPi = std::numbers::pi;
constexpr unsigned kSeed = 7;
// Angles on both sides of every switch between series and closed form, up to pi.
const double kAngles[] = {0,        1e-300,     1e-160,     1e-12,      1e-8, 9.99e-4,
                          1.001e-3, 9.99e-3,    1.001e-2,   0.1,        1,    2,
                          3,        kPi - 1e-3, kPi - 1e-7, kPi - 1e-11};

Eigen::Matrix4d matrix_of(const Sim3& S) {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.topLeftCorner<3, 3>() = S.scale() * S.rotation().toRotationMatrix();
  m.topRightCorner<3, 1>() = S.translation();
  return m;
}
Eigen::Matrix4d algebra_of(const Vector7d& v) {
  Eigen::Matrix4d m = Eigen::Matrix4d::Zero();
  m.topLeftCorner<3, 3>() = skew(v.segment<3>(3)) + v[6] * Eigen::Matrix3d::Identity();
  m.topRightCorner<3, 1>() = v.head<3>();
  return m;
}
Vector7d with_sigma(const Vector6d& v, double sigma) {
  Vector7d out;
  out << v, sigma;
  return out;
}
Pose random_pose(std::mt19937& rng) {
  Vector6d v;
  v << random_vector<3>(rng, 5), random_rotation(rng, 2);
  return Pose::exp(v);
}

TEST(So3, ExpIsTheMatrixExponential) {
  std::mt19937 rng(kSeed);
  for (const double angle : kAngles) {
    const Eigen::Vector3d phi = random_rotation(rng, angle);
    const Eigen::Matrix3d expected = skew(phi).exp();
    EXPECT_LT((so3_exp(phi).toRotationMatrix() - expected).norm(), 1e-13) << angle;
  }
}

TEST(So3, LogInvertsExpUpToPi) {
  std::mt19937 rng(kSeed);
  for (const double angle : kAngles) {
    for (int i = 0; i < 20; ++i) {
      const Eigen::Vector3d phi = random_rotation(rng, angle);
      const Eigen::Quaterniond q = so3_exp(phi);
      EXPECT_LT((so3_log(q) - phi).norm(), 1e-14 + 1e-14 * angle) << angle;
      const Eigen::Quaterniond other(-q.w(), -q.x(), -q.y(), -q.z());
      EXPECT_LT((so3_log(other) - phi).norm(), 1e-14 + 1e-14 * angle) << angle;
    }
  }
}

TEST(So3, TinyAnglesKeepTheirRelativePrecision) {
  const Eigen::Vector3d phi(1e-160, -2e-160, 3e-160);
  EXPECT_LT((so3_log(so3_exp(phi)) - phi).norm(), 1e-15 * phi.norm());
}

TEST(So3, LogAtPiIsPiAboutTheAxis) {
  const Eigen::Vector3d phi = so3_log(Eigen::Quaterniond(0, 0, -1, 0));
  EXPECT_NEAR(phi.norm(), kPi, 1e-15);
  EXPECT_NEAR(std::abs(phi.y()), kPi, 1e-15);
  EXPECT_EQ(so3_log(Eigen::Quaterniond::Identity()), Eigen::Vector3d::Zero());
}

TEST(So3, RightJacobianMatchesFiniteDifferences) {
  std::mt19937 rng(kSeed);
  for (const double angle : kAngles) {
    const Eigen::Vector3d phi = random_rotation(rng, angle);
    const Eigen::Quaterniond back = so3_exp(phi).conjugate();
    const Eigen::Matrix3d numeric = finite_difference<3, 3>(
        [&](const Eigen::Vector3d& d) { return so3_log(back * so3_exp(phi + d)); },
        Eigen::Vector3d::Zero().eval(), 1e-5);
    EXPECT_LT((so3_right_jacobian(phi) - numeric).norm(), 1e-9) << angle;
    EXPECT_LT(
        (so3_right_jacobian(phi) * so3_right_jacobian_inverse(phi) - Eigen::Matrix3d::Identity())
            .norm(),
        1e-12)
        << angle;
  }
}

TEST(Pose, ExpIsTheMatrixExponentialAndLogInverts) {
  std::mt19937 rng(kSeed);
  for (const double angle : kAngles) {
    Vector6d v;
    v << random_vector<3>(rng, 3), random_rotation(rng, angle);
    const Pose T = Pose::exp(v);
    const Eigen::Matrix4d expected = algebra_of(with_sigma(v, 0)).exp();
    EXPECT_LT((T.matrix() - expected).norm(), 1e-12) << angle;
    EXPECT_LT((T.log() - v).norm(), 1e-12) << angle;
  }
}

TEST(Pose, ComposesLikeMatrices) {
  std::mt19937 rng(kSeed);
  for (int i = 0; i < 50; ++i) {
    const Pose A = random_pose(rng), B = random_pose(rng);
    const Eigen::Vector3d p = random_vector<3>(rng, 10);
    EXPECT_LT(((A * B).matrix() - A.matrix() * B.matrix()).norm(), 1e-12);
    EXPECT_LT((A.inverse().matrix() - A.matrix().inverse()).norm(), 1e-12);
    EXPECT_LT((A * (B * p) - (A * B) * p).norm(), 1e-12);
    EXPECT_LT((A.inverse() * (A * p) - p).norm(), 1e-12);
  }
}

TEST(Pose, StaysARotationOverManyProducts) {
  std::mt19937 rng(kSeed);
  Pose T;
  for (int i = 0; i < 100000; ++i) T = T * Pose::exp(random_vector<6>(rng, 0.1));
  EXPECT_NEAR(T.rotation().norm(), 1, 1e-14);
  EXPECT_TRUE(T.finite());
}

TEST(Pose, AdjointMovesAPerturbationFromRightToLeft) {
  std::mt19937 rng(kSeed);
  for (int i = 0; i < 20; ++i) {
    const Pose T = random_pose(rng);
    const Vector6d d = random_vector<6>(rng, 0.5);
    EXPECT_LT(((T * Pose::exp(d)).matrix() - (Pose::exp(T.adjoint() * d) * T).matrix()).norm(),
              1e-12);
  }
}

TEST(Pose, PointJacobianOfTheRightPerturbation) {
  // d(T exp(d) p)/d(d) = R [I, -[p]x]: what every cost function is built on.
  std::mt19937 rng(kSeed);
  const Pose T = random_pose(rng);
  const Eigen::Vector3d p = random_vector<3>(rng, 4);
  Eigen::Matrix<double, 3, 6> analytic;
  analytic << T.R(), -T.R() * skew(p);
  const auto numeric = finite_difference<3, 6>(
      [&](const Vector6d& d) -> Eigen::Vector3d { return T * Pose::exp(d) * p; },
      Vector6d::Zero().eval());
  EXPECT_LT((analytic - numeric).norm(), 1e-8);
}

TEST(Pose, FiniteSeesNan) {
  EXPECT_TRUE(Pose().finite());
  EXPECT_FALSE(Pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0, NAN, 0)).finite());
}

TEST(Sim3, ExpIsTheMatrixExponentialAndLogInverts) {
  std::mt19937 rng(kSeed);
  for (const double angle : kAngles) {
    for (const double sigma : {0.0, 1e-14, -1e-9, 1e-5, -1e-3, 0.02, -0.7, 3.0, -6.0}) {
      Vector6d v;
      v << random_vector<3>(rng, 3), random_rotation(rng, angle);
      const Vector7d tangent = with_sigma(v, sigma);
      const Sim3 S = Sim3::exp(tangent);
      const Eigen::Matrix4d expected = algebra_of(tangent).exp();
      EXPECT_LT((matrix_of(S) - expected).norm(), 1e-12 * expected.norm()) << angle << " " << sigma;
      EXPECT_LT((S.log() - tangent).norm(), 1e-11) << angle << " " << sigma;
    }
  }
}

TEST(Sim3, ComposesLikeMatrices) {
  std::mt19937 rng(kSeed);
  for (int i = 0; i < 50; ++i) {
    const Sim3 A = Sim3::exp(random_vector<7>(rng, 1)), B = Sim3::exp(random_vector<7>(rng, 1));
    const Eigen::Vector3d p = random_vector<3>(rng, 10);
    EXPECT_LT((matrix_of(A * B) - matrix_of(A) * matrix_of(B)).norm(), 1e-11);
    EXPECT_LT((matrix_of(A.inverse()) - matrix_of(A).inverse()).norm(), 1e-11);
    EXPECT_LT((A.inverse() * (A * p) - p).norm(), 1e-11);
    EXPECT_LT(((A * B) * p - A * (B * p)).norm(), 1e-11);
  }
}

TEST(Sim3, RightPerturbationOfAPoint) {
  // d(S exp(d) p)/d(d) = s R [I, -[p]x, p].
  std::mt19937 rng(kSeed);
  const Sim3 S = Sim3::exp(random_vector<7>(rng, 1));
  const Eigen::Vector3d p = random_vector<3>(rng, 4);
  const Eigen::Matrix3d sR = S.scale() * S.rotation().toRotationMatrix();
  Eigen::Matrix<double, 3, 7> analytic;
  analytic << sR, -sR * skew(p), sR * p;
  const auto numeric = finite_difference<3, 7>(
      [&](const Vector7d& d) -> Eigen::Vector3d { return S * Sim3::exp(d) * p; },
      Vector7d::Zero().eval());
  EXPECT_LT((analytic - numeric).norm(), 1e-7);
}

TEST(Sim3, MovesACameraWithItsScene) {
  // A camera and a point that both go through S: the point keeps its direction in the camera, and
  // its depth is scaled.
  std::mt19937 rng(kSeed);
  for (int i = 0; i < 20; ++i) {
    const Sim3 S = Sim3::exp(random_vector<7>(rng, 1));
    const Pose T_world_camera = random_pose(rng);
    const Eigen::Vector3d p_camera = random_vector<3>(rng, 4);
    const Eigen::Vector3d p_moved = S * (T_world_camera * p_camera);
    EXPECT_LT(((S * T_world_camera).inverse() * p_moved - S.scale() * p_camera).norm(), 1e-11);
  }
}

}  // namespace
}  // namespace corvid
