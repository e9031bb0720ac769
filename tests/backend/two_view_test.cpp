#include "backend/two_view.h"

#include <gtest/gtest.h>

#include <random>

#include "backend/simulator.h"
#include "backend/triangulate.h"

namespace corvid {
namespace {

enum class Shape { volume, plane, tilted };

std::vector<PixelPair> make_pairs(const Camera& camera, const Pose& T_a_b, Shape shape,
                                  double outliers, std::uint64_t seed, double noise_px = 0.3) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> u(0, 1);
  std::normal_distribution<double> normal(0, noise_px);
  std::vector<PixelPair> pairs;
  while (pairs.size() < 300) {
    const Eigen::Vector2d a(20 + 700 * u(random), 20 + 440 * u(random));
    const auto ray = camera.unproject(a);
    if (!ray) continue;
    double depth = 4 + 5 * u(random);
    if (shape == Shape::plane) depth = 6 / ray->z();
    if (shape == Shape::tilted) depth = 6 / (ray->z() - 0.6 * ray->y());
    if (depth <= 0) continue;
    const auto b = camera.project(T_a_b.inverse() * (depth * *ray));
    if (!b || !camera.in_image(*b)) continue;
    PixelPair pair;
    pair.sigma_px = 0.3;
    pair.a = a + Eigen::Vector2d(normal(random), normal(random));
    pair.b = *b + Eigen::Vector2d(normal(random), normal(random));
    if (u(random) < outliers) pair.b = {752 * u(random), 480 * u(random)};
    pairs.push_back(pair);
  }
  return pairs;
}

double rotation_error(const Pose& a, const Pose& b) {
  return so3_log(a.rotation().conjugate() * b.rotation()).norm();
}
double direction_error(const Pose& a, const Pose& b) {
  return angle_between(a.translation(), b.translation());
}

struct Motion {
  const char* name;
  Pose T_a_b;
};

const Motion kMotions[] = {
    {"sideways", Pose(so3_exp({0.02, -0.05, 0.03}), {0.6, 0.1, 0})},
    {"forward", Pose(so3_exp({0.01, 0.02, 0.03}), {0.05, 0.05, 1.2})},
    {"up", Pose(so3_exp({0.1, 0.0, 0.2}), {0.0, -0.7, 0.1})},
};

TEST(TwoView, FindsTheMotionInAVolume) {
  for (const Camera& camera : {test::pinhole_camera(), test::radtan_camera(),
                               test::equidistant_camera(), test::fov_camera()}) {
    for (const Motion& m : kMotions) {
      for (const double outliers : {0.0, 0.3}) {
        SCOPED_TRACE(std::string(m.name) + " " + std::string(to_string(camera.model)));
        const auto pairs = make_pairs(camera, m.T_a_b, Shape::volume, outliers, 11);
        const TwoView v = two_view(camera, pairs, {});
        ASSERT_TRUE(v.accepted) << v.reason;
        EXPECT_LT(rotation_error(v.motion.T_a_b, m.T_a_b), 0.01);
        EXPECT_LT(direction_error(v.motion.T_a_b, m.T_a_b), 0.05);
        EXPECT_NEAR(v.motion.T_a_b.translation().norm(), 1, 1e-9);
        EXPECT_EQ(v.motion.index.size(), v.motion.p_a.size());
        double sum_px2 = 0;
        for (std::size_t i = 0; i < v.motion.index.size(); ++i) {
          const auto pixel = camera.project(v.motion.T_a_b.inverse() * v.motion.p_a[i]);
          ASSERT_TRUE(pixel);
          sum_px2 += (*pixel - pairs[static_cast<std::size_t>(v.motion.index[i])].b).squaredNorm();
        }
        EXPECT_LT(sum_px2, static_cast<double>(v.motion.index.size()));
        EXPECT_GT(v.motion.median_parallax_rad, 0.02);
      }
    }
  }
}

TEST(TwoView, FindsTheMotionOverAPlaneOrNamesBoth) {
  const Camera camera = test::radtan_camera();
  int alone = 0;
  for (const Motion& m : kMotions) {
    for (const Shape shape : {Shape::plane, Shape::tilted}) {
      for (std::uint64_t seed = 1; seed <= 3; ++seed) {
        SCOPED_TRACE(m.name);
        const auto pairs = make_pairs(camera, m.T_a_b, shape, 0.1, seed);
        const TwoView v = two_view(camera, pairs, {});
        ASSERT_TRUE(v.accepted) << v.reason;
        const auto right = [&](const TwoViewMotion& motion) {
          return rotation_error(motion.T_a_b, m.T_a_b) < 0.02 &&
                 direction_error(motion.T_a_b, m.T_a_b) < 0.1;
        };
        EXPECT_TRUE(right(v.motion) || (v.rival && right(*v.rival)))
            << rotation_error(v.motion.T_a_b, m.T_a_b) << " "
            << direction_error(v.motion.T_a_b, m.T_a_b);
        alone += v.rival ? 0 : 1;
      }
    }
  }
  EXPECT_GE(alone, 6);
}

TEST(TwoView, RefusesRotationAndStandingStill) {
  const Camera camera = test::radtan_camera();
  for (const double angle : {0.0, 0.05, 0.3}) {
    for (const double outliers : {0.0, 0.15}) {
      const Pose T(so3_exp({0, angle, 0.5 * angle}), Eigen::Vector3d::Zero());
      const TwoView v = two_view(camera, make_pairs(camera, T, Shape::volume, outliers, 2), {});
      EXPECT_FALSE(v.accepted);
      EXPECT_NE(v.reason.find("turns"), std::string::npos) << v.reason;
    }
  }
}

TEST(TwoView, RefusesTooLittleParallaxEvenWhereRotationDoesNotExplainAll) {
  const Camera camera = test::radtan_camera();
  const Pose T(so3_exp({0, 0.1, 0}), {0.06, 0, 0});
  const TwoView v = two_view(camera, make_pairs(camera, T, Shape::volume, 0.1, 2), {});
  EXPECT_FALSE(v.accepted);
  EXPECT_FALSE(v.reason.empty());
}

TEST(TwoView, RefusesNoise) {
  const Camera camera = test::radtan_camera();
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const TwoView v =
        two_view(camera, make_pairs(camera, kMotions[0].T_a_b, Shape::volume, 1.0, seed), {});
    EXPECT_FALSE(v.accepted);
    EXPECT_FALSE(v.reason.empty());
  }
}

TEST(TwoView, RefusesTooFewPairs) {
  const Camera camera = test::radtan_camera();
  EXPECT_FALSE(two_view(camera, {}, {}).accepted);
  auto pairs = make_pairs(camera, kMotions[0].T_a_b, Shape::volume, 0, 1);
  pairs.resize(40);
  EXPECT_NE(two_view(camera, pairs, {}).reason.find("too few tracks"), std::string::npos);
}

TEST(TwoView, RepeatsBitForBit) {
  const Camera camera = test::radtan_camera();
  const auto pairs = make_pairs(camera, kMotions[1].T_a_b, Shape::volume, 0.3, 4);
  const TwoView a = two_view(camera, pairs, {}), b = two_view(camera, pairs, {});
  ASSERT_TRUE(a.accepted);
  EXPECT_EQ(a.motion.T_a_b.matrix(), b.motion.T_a_b.matrix());
  EXPECT_EQ(a.motion.index, b.motion.index);
}

}  // namespace
}  // namespace corvid
