#include "backend/bundle.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <iostream>
#include <random>

#include "backend/bundle_case.h"
#include "backend/simulator.h"

namespace corvid {
namespace {

using test::Case;
using test::make_case;

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
    const SolveResult r = adjust(c.start, settings);
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

TEST(Bundle, AStopKeepsWhatWasReached) {
  const Case c = make_case(test::radtan_camera(), 8, 200, 0.3, 8);
  BundleSettings settings;
  settings.max_iterations = 50;
  std::vector<double> costs;
  settings.on_iteration = [&](int, double cost) { costs.push_back(cost); };
  BundleProblem whole = c.start;
  const SolveResult end = adjust(whole, settings);
  ASSERT_TRUE(end.ok);
  EXPECT_FALSE(end.stopped);
  ASSERT_GT(costs.size(), 3U);
  EXPECT_DOUBLE_EQ(costs.front(), end.initial_cost);
  EXPECT_DOUBLE_EQ(costs.back(), end.final_cost);

  std::stop_source stop;
  settings.stop = stop.get_token();
  settings.on_iteration = [&](int iteration, double) {
    if (iteration == 1) stop.request_stop();
  };
  BundleProblem part = c.start;
  const SolveResult r = adjust(part, settings);
  EXPECT_TRUE(r.ok && r.stopped);
  EXPECT_EQ(r.iterations, 2);  // the start counts
  EXPECT_DOUBLE_EQ(r.final_cost, costs[1]);
  EXPECT_LT(r.final_cost, r.initial_cost);
  EXPECT_LT(worst_pose(part, c.truth), worst_pose(c.start, c.truth));

  BundleProblem none = c.start;
  const SolveResult at_once = adjust(none, settings);  // asked before it began
  EXPECT_TRUE(at_once.ok && at_once.stopped);
  EXPECT_LT(worst_pose(none, c.start), 1e-12);
}

TEST(Bundle, RepeatsBitForBitOnOneThread) {
  const Case c = make_case(test::radtan_camera(), 8, 200, 0.3, 6);
  BundleProblem a = c.start, b = c.start;
  ASSERT_TRUE(adjust(a, {}).ok);
  ASSERT_TRUE(adjust(b, {}).ok);
  for (std::size_t i = 0; i < a.points.size(); ++i) EXPECT_EQ(a.points[i], b.points[i]);
  EXPECT_EQ(worst_pose(a, b), 0);
}

}  // namespace
}  // namespace corvid
