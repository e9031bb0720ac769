#include "backend/bundle.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <iostream>
#include <random>

#include "backend/simulator.h"

namespace corvid {
namespace {

struct Case {
  BundleProblem truth;  ///< exact poses and points, noisy pixels
  BundleProblem start;  ///< disturbed
};

Case make_case(const Camera& camera, int poses, int points, double noise_px, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> u(-1, 1);
  std::normal_distribution<double> normal;
  Case c;
  c.truth.camera = camera;
  for (int i = 0; i < poses; ++i) {
    c.truth.T_world_camera.emplace_back(so3_exp({0.05 * u(random), -0.03 * i, 0.05 * u(random)}),
                                        Eigen::Vector3d(0.4 * i, 0.1 * u(random), 0.1 * u(random)));
  }
  c.truth.fixed.assign(static_cast<std::size_t>(poses), 0);
  c.truth.fixed[0] = 1;
  c.truth.hold_distance = {{0, 1}};
  for (int j = 0; j < points; ++j) {
    c.truth.points.emplace_back(1 + 3 * u(random), 2 * u(random), 6 + 2 * u(random));
    for (int i = 0; i < poses; ++i) {
      const Pose& T = c.truth.T_world_camera[static_cast<std::size_t>(i)];
      const auto pixel = camera.project(T.inverse() * c.truth.points.back());
      if (!pixel || !camera.in_image(*pixel)) continue;
      c.truth.observations.push_back(
          {i, j, *pixel + noise_px * Eigen::Vector2d(normal(random), normal(random)),
           std::max(0.3, noise_px)});
    }
  }
  c.start = c.truth;
  // The second pose turns only, so that the held distance is the true one.
  for (std::size_t i = 1; i < c.start.T_world_camera.size(); ++i) {
    const Pose& T = c.truth.T_world_camera[i];
    const Eigen::Vector3d shift =
        i == 1 ? Eigen::Vector3d::Zero()
               : Eigen::Vector3d(0.03 * u(random), 0.03 * u(random), 0.03 * u(random));
    c.start.T_world_camera[i] =
        Pose(T.rotation() * so3_exp({0.01 * u(random), 0.01 * u(random), 0.01 * u(random)}),
             T.translation() + shift);
  }
  for (auto& p : c.start.points) p += 0.1 * Eigen::Vector3d(u(random), u(random), u(random));
  return c;
}

double worst_pose(const BundleProblem& a, const BundleProblem& b) {
  double worst = 0;
  for (std::size_t i = 0; i < a.T_world_camera.size(); ++i) {
    worst = std::max(worst, (a.T_world_camera[i].inverse() * b.T_world_camera[i]).log().norm());
  }
  return worst;
}

TEST(Bundle, RecoversTheExactSceneForEveryCameraModel) {
  for (const Camera& camera : {test::pinhole_camera(), test::radtan_camera(),
                               test::equidistant_camera(), test::fov_camera()}) {
    Case c = make_case(camera, 6, 150, 0, 1);
    BundleSettings settings;
    settings.max_iterations = 50;
    const BundleResult r = adjust(c.start, settings);
    ASSERT_TRUE(r.ok);
    EXPECT_LT(r.final_cost, 1e-6 * r.initial_cost);
    EXPECT_LT(worst_pose(c.start, c.truth), 1e-4);
  }
}

TEST(Bundle, FixedPosesDoNotMoveAndTheScaleIsHeld) {
  Case c = make_case(test::radtan_camera(), 6, 150, 0.5, 2);
  const BundleProblem before = c.start;
  const double distance =
      (before.T_world_camera[1].translation() - before.T_world_camera[0].translation()).norm();
  ASSERT_TRUE(adjust(c.start, {}).ok);
  EXPECT_EQ(c.start.T_world_camera[0].matrix(), before.T_world_camera[0].matrix());
  EXPECT_NEAR(
      (c.start.T_world_camera[1].translation() - c.start.T_world_camera[0].translation()).norm(),
      distance, 1e-4 * distance);
}

TEST(Bundle, OutliersBarelyMove) {
  Case clean = make_case(test::radtan_camera(), 6, 300, 0.3, 3);
  Case dirty = clean;
  std::mt19937_64 random(4);
  for (std::size_t i = 0; i < dirty.start.observations.size(); i += 12) {
    dirty.start.observations[i].pixel += Eigen::Vector2d(static_cast<double>(random() % 200) - 100,
                                                         static_cast<double>(random() % 200) - 100);
  }
  BundleSettings settings;
  settings.max_iterations = 50;
  ASSERT_TRUE(adjust(clean.start, settings).ok);
  ASSERT_TRUE(adjust(dirty.start, settings).ok);
  EXPECT_LT(worst_pose(clean.start, clean.truth), 0.02);
  EXPECT_LT(worst_pose(dirty.start, clean.start), 0.01);
}

TEST(Bundle, IntrinsicsAreFound) {
  Case c = make_case(test::radtan_camera(), 10, 300, 0.3, 5);
  const Camera truth = c.truth.camera;
  BundleSettings settings;
  settings.max_iterations = 60;
  settings.freedom = IntrinsicsFreedom::all;
  settings.intrinsics_prior = truth;
  settings.intrinsics_prior.fx_px *= 1.03;
  settings.intrinsics_prior.fy_px *= 1.03;
  settings.intrinsics_prior.distortion[0] += 0.03;
  c.start.camera = settings.intrinsics_prior;
  ASSERT_TRUE(adjust(c.start, settings).ok);
  EXPECT_NEAR(c.start.camera.fx_px / truth.fx_px, 1, 0.006);
  EXPECT_NEAR(c.start.camera.distortion[0], truth.distortion[0], 0.01);
  EXPECT_NEAR(c.start.camera.fx_px / c.start.camera.fy_px, truth.fx_px / truth.fy_px, 1e-12);
}

TEST(Bundle, AWholeLensIsFoundWhereTheRaysAreWide) {
  Camera lens = test::radtan_camera();
  lens.cx_px += 9;
  lens.cy_px -= 7;
  lens.distortion = {-0.2, 0.05, 0.002, -0.003, 0.01};
  Case c = make_case(lens, 12, 400, 0.1, 7);
  BundleSettings settings;
  settings.max_iterations = 100;
  settings.freedom = IntrinsicsFreedom::focal;
  settings.intrinsics_prior = test::radtan_camera();
  settings.intrinsics_prior.distortion = {-0.2, 0.05, 0, 0, 0};
  c.start.camera = settings.intrinsics_prior;
  BundleProblem focal = c.start;
  ASSERT_TRUE(adjust(focal, settings).ok);
  EXPECT_EQ(focal.camera.cx_px, settings.intrinsics_prior.cx_px);
  EXPECT_EQ(focal.camera.distortion[2], 0);
  settings.freedom = IntrinsicsFreedom::all;
  ASSERT_TRUE(adjust(c.start, settings).ok);
  const Camera& found = c.start.camera;
  EXPECT_NEAR(found.cx_px, lens.cx_px, 1.5);
  EXPECT_NEAR(found.cy_px, lens.cy_px, 1.5);
  EXPECT_NEAR(found.distortion[2], 0.002, 0.001);
  EXPECT_NEAR(found.distortion[3], -0.003, 0.001);
}

TEST(Bundle, AnEmptyProblemIsNoSuccessAndChangesNothing) {
  BundleProblem empty;
  EXPECT_FALSE(adjust(empty, {}).ok);
}

TEST(Bundle, RepeatsBitForBitOnOneThread) {
  const Case c = make_case(test::radtan_camera(), 8, 200, 0.3, 6);
  BundleProblem a = c.start, b = c.start;
  ASSERT_TRUE(adjust(a, {}).ok);
  ASSERT_TRUE(adjust(b, {}).ok);
  for (std::size_t i = 0; i < a.points.size(); ++i) EXPECT_EQ(a.points[i], b.points[i]);
  EXPECT_EQ(worst_pose(a, b), 0);
}

TEST(Bundle, PoseCovarianceMatchesTheErrors) {
  double sum = 0;
  constexpr int kTrials = 80, kPose = 4;
  for (int trial = 0; trial < kTrials; ++trial) {
    Case c = make_case(test::radtan_camera(), 5, 60, 0.5, 50 + static_cast<std::uint64_t>(trial));
    c.start.fixed[1] = 1;  // two exact poses: the gauge
    c.start.T_world_camera[1] = c.truth.T_world_camera[1];
    c.start.hold_distance.clear();
    BundleSettings settings;
    settings.huber_px = 3;
    settings.max_iterations = 30;
    ASSERT_TRUE(adjust(c.start, settings).ok);
    const Matrix6d P = pose_covariance(c.start, kPose, settings.huber_px);
    const Vector6d e =
        (c.start.T_world_camera[kPose].inverse() * c.truth.T_world_camera[kPose]).log();
    sum += e.dot(P.ldlt().solve(e));
    EXPECT_EQ(pose_covariance(c.start, 0, settings.huber_px), Matrix6d(Matrix6d::Zero()));
  }
  const double nees = sum / kTrials / 6;
  std::cout << "  normalised squared error per degree of freedom: " << nees << "\n";
  EXPECT_GT(nees, 0.7);
  EXPECT_LT(nees, 1.4);
}

}  // namespace
}  // namespace corvid
