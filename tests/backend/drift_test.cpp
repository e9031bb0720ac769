#include "backend/drift.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <iostream>

#include "backend/bundle_case.h"
#include "backend/simulator.h"

namespace corvid {
namespace {

/// Variance of the range of a point along a ray, the poses taken as exact, over the range squared.
double log_range_variance(const BundleProblem& p, int point, const Eigen::Vector3d& ray) {
  Eigen::Matrix3d V = Eigen::Matrix3d::Zero();
  for (const BundleObservation& o : p.observations) {
    if (o.point != point) continue;
    const Pose T_camera_world = p.T_world_camera[static_cast<std::size_t>(o.pose)].inverse();
    Eigen::Matrix<double, 2, 3> J;
    EXPECT_TRUE(p.camera.project(T_camera_world * p.points[static_cast<std::size_t>(o.point)], &J));
    V += T_camera_world.R().transpose() * J.transpose() * J * T_camera_world.R() /
         (o.sigma_px * o.sigma_px);
  }
  return ray.dot(V.ldlt().solve(ray)) / std::pow(ray.squaredNorm(), 2);
}

/// Mean log ratio of estimated and true ranges of the points seen from a pose, by certainty.
double log_scale(const BundleProblem& estimate, const BundleProblem& truth, std::size_t pose) {
  double sum = 0, weights = 0;
  for (const BundleObservation& o : estimate.observations) {
    if (static_cast<std::size_t>(o.pose) != pose) continue;
    const auto ray = [&](const BundleProblem& p) -> Eigen::Vector3d {
      return p.points[static_cast<std::size_t>(o.point)] - p.T_world_camera[pose].translation();
    };
    const double weight = 1 / log_range_variance(estimate, o.point, ray(estimate));
    sum += weight * std::log(ray(estimate).norm() / ray(truth).norm());
    weights += weight;
  }
  return sum / weights;
}

/// Error of the similarity of `newest` relative to that of `anchor`: (rho, phi, sigma).
Vector7d similarity_error(const BundleProblem& estimate, const BundleProblem& truth,
                          std::size_t anchor, std::size_t newest) {
  const double at_anchor = log_scale(estimate, truth, anchor);
  const auto relative = [&](const BundleProblem& p, double shrink) {
    const Pose T = p.T_world_camera[anchor].inverse() * p.T_world_camera[newest];
    return Pose(T.rotation(), T.translation() * shrink);
  };
  Vector7d e;
  e.head<6>() = (relative(truth, 1).inverse() * relative(estimate, std::exp(-at_anchor))).log();
  e[6] = log_scale(estimate, truth, newest) - at_anchor;
  return e;
}

TEST(Drift, CovarianceMatchesTheErrors) {
  constexpr int kTrials = 120;
  constexpr std::size_t kAnchor = 1, kNewest = 5;
  double sum = 0;
  Vector7d ratio = Vector7d::Zero();
  for (int trial = 0; trial < kTrials; ++trial) {
    test::Case c =
        test::make_case(test::radtan_camera(), 6, 120, 0.5, 50 + static_cast<std::uint64_t>(trial));
    BundleSettings settings;
    settings.huber_px = 3;
    settings.max_iterations = 40;
    ASSERT_TRUE(adjust(c.start, settings).ok);
    const DriftLink link = drift_link(c.start, kAnchor, kNewest, settings.huber_px);
    ASSERT_TRUE(link.ok);
    const Vector7d e = similarity_error(c.start, c.truth, kAnchor, kNewest);
    sum += e.dot(link.drift.covariance.ldlt().solve(e));
    ratio += e.cwiseAbs2().cwiseQuotient(link.drift.covariance.diagonal());
  }
  const double nees = sum / kTrials / 7;
  std::cout << "  normalised squared error per degree of freedom: " << nees
            << ", of each: " << (ratio / kTrials).transpose() << "\n";
  EXPECT_GT(nees, 0.7);
  EXPECT_LT(nees, 1.4);
  for (int i = 0; i < 7; ++i) {
    EXPECT_GT(ratio[i] / kTrials, 0.5) << i;
    EXPECT_LT(ratio[i] / kTrials, 1.6) << i;
  }
}

TEST(Drift, AWrongFocalLengthIsFoundAndItsEffectForeseen) {
  for (const double factor : {0.97, 1.05}) {
    test::Case c = test::make_case(test::pinhole_camera(), 8, 300, 0.1, 7);
    c.start.camera.fx_px *= factor;
    c.start.camera.fy_px *= factor;
    BundleSettings settings;
    settings.huber_px = 3;
    settings.max_iterations = 100;
    settings.cost_tolerance = 1e-9;
    ASSERT_TRUE(adjust(c.start, settings).ok);
    const DriftLink link = drift_link(c.start, 0, 7, settings.huber_px);
    ASSERT_TRUE(link.ok);
    const double wrong = 1 / factor - 1;
    std::cout << "  asks for " << link.focal.share << " +- " << link.focal.sigma << " of " << wrong
              << "\n";
    EXPECT_NEAR(link.focal.share, wrong, 0.2 * std::abs(wrong));
    EXPECT_LT(link.focal.sigma, 0.01);
    // Told too long by log(factor): by_focal is by the focal length in use.
    const Vector7d expected = std::log(factor) * link.drift.by_focal;
    const Vector7d error = similarity_error(c.start, c.truth, 0, 7);
    std::cout << "  error " << error.transpose() << "\n  expected " << expected.transpose() << "\n";
    EXPECT_LT((error - expected).norm(), 0.25 * error.norm());
    EXPECT_GT(error.norm(), 0.005);
  }
}

TEST(Drift, WhatHangsTogetherTooLooselyHasNoLink) {
  EXPECT_FALSE(
      drift_link({test::pinhole_camera(), {Pose(), Pose()}, {1, 0}, {}, {}, {}, {}}, 0, 1, 1).ok);
  // A camera that stands still sees no ranges.
  test::Case c = test::make_case(test::pinhole_camera(), 2, 50, 0, 1);
  for (BundleObservation& o : c.start.observations) {
    if (const auto pixel =
            c.truth.camera.project(c.truth.points[static_cast<std::size_t>(o.point)]))
      o.pixel = *pixel;
  }
  c.start.T_world_camera = {Pose(), Pose()};
  c.start.points = c.truth.points;
  EXPECT_FALSE(drift_link(c.start, 0, 1, 1).ok);
}

TEST(Drift, AScaleThatIsUnknownMovesWhatComesLater) {
  Drift drift;
  drift.known = true;
  drift.covariance(6, 6) = 0.01 * 0.01;
  const Pose T_here_there(so3_exp({0.1, 0.2, -0.3}), Eigen::Vector3d(5, 0, 0));
  const Drift there = drift.seen_from(T_here_there);
  const Matrix6d P = there.pose_covariance(0);
  EXPECT_NEAR(std::sqrt((P.topLeftCorner<3, 3>().trace())), 0.05, 1e-12);
  EXPECT_EQ(there.covariance(6, 6), drift.covariance(6, 6));
  EXPECT_NEAR((P.bottomRightCorner<3, 3>().norm()), 0, 1e-12);
}

TEST(FocalBelief, GoodCalibrationsStayGoodAndWrongOnesAreFoundOut) {
  FocalBelief nothing_seen(true), good(true), wrong(true);
  EXPECT_NEAR(nothing_seen.wrong(), 0.05, 1e-12);
  EXPECT_NEAR(std::sqrt(nothing_seen.square()), 0.023, 0.001);
  for (int i = 0; i < 20; ++i) {
    good.add({0.004, 0.01}, 10);
    wrong.add({0.1, 0.01}, 10);
  }
  EXPECT_LT(good.wrong(), 0.02);
  EXPECT_LT(std::sqrt(good.square()), 0.008);
  EXPECT_GT(wrong.wrong(), 0.999);
  EXPECT_NEAR(std::sqrt(wrong.square()), 0.1, 0.01);
  EXPECT_NEAR(wrong.asked(), 0.1, 1e-12);
}

TEST(FocalBelief, AWeakEstimateThatHintsAtAWrongCalibrationWidensWhatIsClaimed) {
  FocalBelief hinted(true);
  hinted.add({0.1, 0.04}, 1);
  EXPECT_LT(hinted.wrong(), 0.99);
  EXPECT_GT(std::sqrt(hinted.square()), 0.04);
  hinted.clear();
  EXPECT_NEAR(hinted.wrong(), 0.05, 1e-12);
}

TEST(FocalBelief, ManyEstimatesOfOneWindowAreWorthOne) {
  FocalBelief one(false), ten(false);
  one.add({0, 0.01}, 10);
  for (int i = 0; i < 10; ++i) ten.add({0, 0.01}, 10);
  EXPECT_NEAR(one.square(), ten.square(), 1e-12);
  EXPECT_EQ(one.wrong(), 1);
  FocalBelief broken(true);
  broken.add({std::nan(""), 0.1}, 1);
  broken.add({0.1, 0}, 1);
  EXPECT_NEAR(broken.wrong(), 0.05, 1e-12);
}

}  // namespace
}  // namespace corvid
