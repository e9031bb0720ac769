#include "backend/resect.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <iostream>
#include <random>

#include "backend/simulator.h"

namespace corvid {
namespace {

struct Case {
  Pose truth;
  std::vector<PointView> points;
  std::vector<std::uint8_t> wrong;
};

Case make_case(const Camera& camera, int count, double noise_px, double outliers,
               std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> u(0, 1);
  std::normal_distribution<double> normal;
  Case c;
  c.truth = Pose(so3_exp({u(random), u(random) - 0.5, 2 * u(random)}),
                 {5 * u(random), u(random), -3 * u(random)});
  while (static_cast<int>(c.points.size()) < count) {
    const Eigen::Vector2d pixel(20 + 700 * u(random), 20 + 440 * u(random));
    const auto ray = camera.unproject(pixel);
    if (!ray) continue;
    PointView p;
    p.p_world = c.truth * ((3 + 6 * u(random)) * *ray);
    p.sigma_px = noise_px > 0 ? noise_px : 1;
    p.pixel = pixel + noise_px * Eigen::Vector2d(normal(random), normal(random));
    c.wrong.push_back(u(random) < outliers ? 1 : 0);
    if (c.wrong.back() != 0) p.pixel = {752 * u(random), 480 * u(random)};
    c.points.push_back(p);
  }
  return c;
}

double distance(const Pose& a, const Pose& b) { return (a.inverse() * b).log().norm(); }

Pose nudged(const Pose& T, double rho, double phi) {
  Vector6d d;
  d << rho, -rho, rho, phi, phi, -phi;
  return T * Pose::exp(d);
}

TEST(Resect, ExactPointsGiveTheExactPoseForEveryCameraModel) {
  for (const Camera& camera : {test::pinhole_camera(), test::radtan_camera(),
                               test::equidistant_camera(), test::fov_camera()}) {
    const Case c = make_case(camera, 100, 0, 0, 1);
    const Resection r = resect(camera, c.points, nudged(c.truth, 0.1, 0.02), {});
    ASSERT_TRUE(r.ok);
    EXPECT_FALSE(r.from_ransac);
    EXPECT_LT(distance(r.T_world_camera, c.truth), 1e-7);
    EXPECT_EQ(r.inliers, 100);
  }
}

TEST(Resect, WithoutAPredictionP3pFindsThePose) {
  for (const Camera& camera : {test::pinhole_camera(), test::equidistant_camera()}) {
    for (std::uint64_t seed = 1; seed <= 10; ++seed) {
      const Case c = make_case(camera, 200, 0.3, 0.4, seed);
      const Resection r = resect(camera, c.points, std::nullopt, {});
      ASSERT_TRUE(r.ok);
      EXPECT_TRUE(r.from_ransac);
      EXPECT_LT(distance(r.T_world_camera, c.truth), 0.01);
      for (std::size_t i = 0; i < c.wrong.size(); ++i) {
        if (c.wrong[i] == 0) {
          EXPECT_EQ(r.inlier[i], 1) << i;
        }
      }
      EXPECT_GE(r.inliers, 100);
    }
  }
}

TEST(Resect, APredictionFarOffIsOverruled) {
  const Camera camera = test::radtan_camera();
  const Case c = make_case(camera, 200, 0.3, 0.2, 5);
  const Resection r = resect(camera, c.points, nudged(c.truth, 3, 1), {});
  ASSERT_TRUE(r.ok);
  EXPECT_LT(distance(r.T_world_camera, c.truth), 0.01);
}

TEST(Resect, NoiseAloneGivesNoPose) {
  const Camera camera = test::radtan_camera();
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const Case c = make_case(camera, 200, 0.3, 1.0, seed);
    const Resection r = resect(camera, c.points, c.truth, {});
    EXPECT_FALSE(r.ok);
    EXPECT_EQ(r.inlier.size(), c.points.size());
    EXPECT_TRUE(r.T_world_camera.finite());
  }
}

TEST(Resect, DegenerateInputGivesNoPose) {
  const Camera camera = test::radtan_camera();
  EXPECT_FALSE(resect(camera, {}, Pose(), {}).ok);
  PointView p;
  p.p_world = {0, 0, 3};
  p.pixel = {camera.cx_px, camera.cy_px};
  const std::vector<PointView> same(50, p);  // one point fifty times
  const Resection r = resect(camera, same, Pose(), {});
  EXPECT_FALSE(r.ok);
  EXPECT_TRUE(r.T_world_camera.finite());
  std::vector<PointView> behind(50, p);
  for (auto& b : behind) b.p_world.z() = -3;
  EXPECT_FALSE(resect(camera, behind, Pose(), {}).ok);
}

TEST(Resect, CovarianceMatchesTheErrors) {
  const Camera camera = test::radtan_camera();
  double sum = 0;
  constexpr int kTrials = 200;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Case c = make_case(camera, 80, 0.5, 0.1, 100 + static_cast<std::uint64_t>(trial));
    const Resection r = resect(camera, c.points, nudged(c.truth, 0.02, 0.01), {});
    ASSERT_TRUE(r.ok);
    const Vector6d e = (r.T_world_camera.inverse() * c.truth).log();
    sum += e.dot(r.covariance.ldlt().solve(e));
  }
  const double nees = sum / kTrials / 6;
  std::cout << "  normalised squared error per degree of freedom: " << nees << "\n";
  EXPECT_GT(nees, 0.75);
  EXPECT_LT(nees, 1.35);
}

TEST(Resect, BetterPixelsWeighMore) {
  const Camera camera = test::radtan_camera();
  Case c = make_case(camera, 200, 0, 0, 9);
  std::mt19937_64 random(2);
  std::normal_distribution<double> normal;
  for (std::size_t i = 0; i < c.points.size(); ++i) {
    c.points[i].sigma_px = i % 2 == 0 ? 0.3 : 1.0;
    c.points[i].pixel += c.points[i].sigma_px * Eigen::Vector2d(normal(random), normal(random));
  }
  const Resection weighted = resect(camera, c.points, c.truth, {});
  for (PointView& p : c.points) p.sigma_px = 1;
  const Resection flat = resect(camera, c.points, c.truth, {});
  ASSERT_TRUE(weighted.ok && flat.ok);
  EXPECT_LT(distance(weighted.T_world_camera, c.truth), distance(flat.T_world_camera, c.truth));
}

TEST(Resect, RepeatsBitForBit) {
  const Camera camera = test::radtan_camera();
  const Case c = make_case(camera, 200, 0.3, 0.5, 3);
  const Resection a = resect(camera, c.points, std::nullopt, {});
  const Resection b = resect(camera, c.points, std::nullopt, {});
  EXPECT_EQ(a.T_world_camera.matrix(), b.T_world_camera.matrix());
  EXPECT_EQ(a.inlier, b.inlier);
}

}  // namespace
}  // namespace corvid
