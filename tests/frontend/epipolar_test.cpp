#include "frontend/epipolar.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "corvid/pose.h"

namespace corvid {
namespace {

struct TwoViews {
  Camera camera;
  Pose T_world_a, T_world_b;
  std::vector<Eigen::Vector2d> x_a, x_b;  ///< undistorted pixels
  Eigen::Matrix3d F;                      ///< exact
};

/// Random points in front of two pinhole cameras; `noise_px` on the second view.
TwoViews make_views(const Pose& T_world_b, int points, double noise_px, std::uint64_t seed) {
  TwoViews v;
  v.camera = {CameraModel::pinhole, 640, 480, 500, 500, 320, 240, {}};
  v.T_world_b = T_world_b;
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> u(0, 1);
  std::normal_distribution<double> noise(0, noise_px);
  while (static_cast<int>(v.x_a.size()) < points) {
    const Eigen::Vector3d p(8 * u(random) - 4, 6 * u(random) - 3, 4 + 8 * u(random));
    const auto a = v.camera.project(p);
    const auto b = v.camera.project(T_world_b.inverse() * p);
    if (!a || !b || !v.camera.in_image(*a) || !v.camera.in_image(*b)) continue;
    v.x_a.push_back(*a);
    v.x_b.push_back(*b + Eigen::Vector2d(noise(random), noise(random)));
  }
  const Pose T_b_a = T_world_b.inverse();
  const Eigen::Matrix3d K_inverse = v.camera.K().inverse();
  v.F = K_inverse.transpose() * skew(T_b_a.translation()) * T_b_a.R() * K_inverse;
  v.F /= v.F.norm();
  return v;
}

const Pose kSideways(so3_exp({0.02, -0.1, 0.05}), {1.0, 0.2, 0.1});
const Pose kForward(so3_exp({0.01, 0.02, 0.0}), {0.05, 0.02, 1.0});

TEST(Epipolar, SampsonIsZeroOnExactMatchesAndGrowsByTheOffsetAcrossTheLine) {
  const TwoViews v = make_views(kSideways, 50, 0, 1);
  for (std::size_t i = 0; i < v.x_a.size(); ++i) {
    EXPECT_LT(sampson_distance_px(v.F, v.x_a[i], v.x_b[i]), 1e-9);
    // Moving only the second point by d across its line gives d / sqrt(2) when both gradients are
    // equal; in general between d/2 and d.
    const Eigen::Vector3d line = v.F * v.x_a[i].homogeneous();
    const Eigen::Vector2d across = line.head<2>().normalized();
    const double d = sampson_distance_px(v.F, v.x_a[i], v.x_b[i] + 2 * across);
    EXPECT_GT(d, 1.0);
    EXPECT_LT(d, 2.0);
  }
}

TEST(Epipolar, RansacFindsGeometryUnderHalfOutliers) {
  for (const Pose& motion : {kSideways, kForward}) {
    TwoViews v = make_views(motion, 300, 0.2, 2);
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> u(0, 1);
    for (std::size_t i = 0; i < 150; ++i) v.x_b[i] = {640 * u(random), 480 * u(random)};
    const auto g = estimate_fundamental(v.x_a, v.x_b, 1.0, 7);
    ASSERT_TRUE(g);
    int good = 0, bad = 0;
    for (std::size_t i = 0; i < v.x_a.size(); ++i) (i < 150 ? bad : good) += g->inlier[i];
    EXPECT_GE(good, 140);
    EXPECT_LE(bad, 12);  // chance hits of a 2 px wide band
    for (std::size_t i = 150; i < v.x_a.size(); ++i)
      EXPECT_LT(sampson_distance_px(v.F, v.x_a[i], v.x_b[i]), 1.5);
  }
}

TEST(Epipolar, RefusesTooFewPointsAndRepeatsItself) {
  const TwoViews v = make_views(kSideways, 60, 0.3, 4);
  EXPECT_FALSE(estimate_fundamental(std::span(v.x_a).first(7), std::span(v.x_b).first(7), 1, 1));
  EXPECT_FALSE(estimate_fundamental({}, {}, 1, 1));
  const auto a = estimate_fundamental(v.x_a, v.x_b, 0.5, 9);
  const auto b = estimate_fundamental(v.x_a, v.x_b, 0.5, 9);
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->F, b->F);
  EXPECT_EQ(a->inlier, b->inlier);
}

TEST(Epipolar, IdenticalPointsGiveNoNan) {
  const std::vector<Eigen::Vector2d> same(20, Eigen::Vector2d(100, 100));
  const auto g = estimate_fundamental(same, same, 1, 1);
  ASSERT_TRUE(g) << "they fit any geometry in which they lie on their own lines";
  EXPECT_TRUE(g->F.allFinite());
  EXPECT_EQ(g->inliers, 20);
  EXPECT_TRUE(std::isfinite(sampson_distance_px(g->F, {100, 100}, {100, 100})));
}

TEST(Epipolar, UndistortionIsTheInverseOfTheLens) {
  const Camera camera{CameraModel::radtan,           752, 480, 458, 457, 367, 248,
                      {-0.28, 0.07, 0.0002, 2e-5, 0}};
  Camera pinhole = camera;
  pinhole.model = CameraModel::pinhole;
  pinhole.distortion = {};
  for (double x = -0.6; x <= 0.6; x += 0.2)
    for (double y = -0.4; y <= 0.4; y += 0.2) {
      const Eigen::Vector3d ray(x, y, 1);
      const auto pixel = camera.project(ray);
      ASSERT_TRUE(pixel);
      const auto undistorted = undistort_pixel(camera, *pixel);
      ASSERT_TRUE(undistorted);
      EXPECT_LT((*undistorted - *pinhole.project(ray)).norm(), 1e-6);
    }
}

}  // namespace
}  // namespace corvid
