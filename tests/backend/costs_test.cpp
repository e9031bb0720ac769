#include <gtest/gtest.h>

#include <random>

#include "backend/costs/reprojection.h"
#include "backend/simulator.h"

namespace corvid {
namespace {

using Blocks = std::vector<std::vector<double>>;

/// Moves block b by one tangent coordinate: poses (7 values) on the manifold, others plainly.
Blocks moved(const Blocks& blocks, std::size_t b, int coordinate, double step) {
  Blocks out = blocks;
  if (blocks[b].size() == 7) {
    Vector6d d = Vector6d::Zero();
    d(coordinate) = step;
    PoseManifold().Plus(blocks[b].data(), d.data(), out[b].data());
  } else {
    out[b][static_cast<std::size_t>(coordinate)] += step;
  }
  return out;
}

std::vector<double> residuals_at(const ceres::CostFunction& cost, const Blocks& blocks) {
  std::vector<const double*> pointers;
  for (const auto& b : blocks) pointers.push_back(b.data());
  std::vector<double> r(static_cast<std::size_t>(cost.num_residuals()));
  EXPECT_TRUE(cost.Evaluate(pointers.data(), r.data(), nullptr));
  return r;
}

/// Every column of the Jacobian by the tangent against central differences.
void check_jacobians(const ceres::CostFunction& cost, const Blocks& blocks, double tolerance) {
  const int rows = cost.num_residuals();
  std::vector<const double*> pointers;
  std::vector<std::vector<double>> storage;
  for (const auto& b : blocks) {
    pointers.push_back(b.data());
    storage.emplace_back(b.size() * static_cast<std::size_t>(rows));
  }
  std::vector<double*> jacobians;
  for (auto& s : storage) jacobians.push_back(s.data());
  std::vector<double> r(static_cast<std::size_t>(rows));
  ASSERT_TRUE(cost.Evaluate(pointers.data(), r.data(), jacobians.data()));
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    const bool pose = blocks[b].size() == 7;
    const int columns = pose ? 6 : static_cast<int>(blocks[b].size());
    for (int c = 0; c < columns; ++c) {
      constexpr double kStep = 1e-6;
      const auto plus = residuals_at(cost, moved(blocks, b, c, kStep));
      const auto minus = residuals_at(cost, moved(blocks, b, c, -kStep));
      for (int i = 0; i < rows; ++i) {
        const auto row = static_cast<std::size_t>(i);
        const double numeric = (plus[row] - minus[row]) / (2 * kStep);
        const double analytic = storage[b][row * blocks[b].size() + static_cast<std::size_t>(c)];
        EXPECT_NEAR(analytic, numeric, tolerance * (1 + std::abs(numeric)))
            << "block " << b << " row " << i << " column " << c;
      }
    }
  }
}

std::vector<double> random_pose(std::mt19937_64& random) {
  std::uniform_real_distribution<double> u(-1, 1);
  const Pose T(so3_exp({0.7 * u(random), 0.7 * u(random), 3 * u(random)}),
               Eigen::Vector3d(u(random), u(random), u(random)));
  const PoseBlock block = to_block(T);
  return {block.begin(), block.end()};
}

TEST(Costs, JacobiansOfReprojectionForEveryCameraModel) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> u(-1, 1);
  for (const Camera& camera : {test::pinhole_camera(), test::radtan_camera(),
                               test::equidistant_camera(), test::fov_camera()}) {
    SCOPED_TRACE(to_string(camera.model));
    for (int trial = 0; trial < 50; ++trial) {
      const auto pose = random_pose(random);
      const Eigen::Vector3d p =
          from_block(pose.data()) *
          Eigen::Vector3d(1.5 * u(random), 1.0 * u(random), 3.2 + 1.2 * u(random));
      const Eigen::Vector2d pixel(300 + 200 * u(random), 200 + 200 * u(random));
      const Blocks blocks = {pose, {p.x(), p.y(), p.z()}};
      check_jacobians(ReprojectionCost(&camera, pixel, 1.7), blocks, 1e-5);
      const IntrinsicsBlock k = intrinsics_block(camera, camera);
      Blocks with = blocks;
      with.emplace_back(k.begin(), k.end());
      with.back()[0] += 0.05 * u(random);
      for (std::size_t i = 1; i < 4; ++i) with.back()[i] += 0.01 * u(random);
      check_jacobians(IntrinsicsReprojectionCost(&camera, pixel, 0.8), with, 1e-5);
    }
  }
}

TEST(Costs, JacobiansOfTheGaugeAndThePrior) {
  std::mt19937_64 random(4);
  for (int trial = 0; trial < 20; ++trial) {
    check_jacobians(DistanceCost(0.7, 3), {random_pose(random), random_pose(random)}, 1e-6);
  }
  check_jacobians(IntrinsicsPriorCost({0.1, -0.2, 0.3}, {2, 3, 4, 5, 6, 7, 8, 9}),
                  {{0.2, 0.1, -0.1, 0.3, 0, 0, 1, 2}}, 1e-6);
}

TEST(Costs, PosesAreAManifold) {
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> u(-0.5, 0.5);
  const PoseManifold manifold;
  for (int trial = 0; trial < 20; ++trial) {
    const auto x = random_pose(random);
    Vector6d d;
    for (int i = 0; i < 6; ++i) d(i) = u(random);
    std::vector<double> y(7);
    ASSERT_TRUE(manifold.Plus(x.data(), d.data(), y.data()));
    Vector6d back;
    ASSERT_TRUE(manifold.Minus(y.data(), x.data(), back.data()));
    EXPECT_LT((back - d).norm(), 1e-12);
    // The right perturbation of corvid/pose.h.
    const Pose expected = from_block(x.data()) * Pose::exp(d);
    EXPECT_LT((expected.inverse() * from_block(y.data())).log().norm(), 1e-12);
  }
}

TEST(Costs, APointBehindTheCameraCostsMuchAndPullsNowhere) {
  const Camera camera = test::radtan_camera();
  const PoseBlock pose = to_block(Pose());
  const std::array<double, 3> point{0.1, 0.1, -1};
  const std::array<const double*, 2> blocks{pose.data(), point.data()};
  std::array<double, 2> r{};
  std::array<double, 14> d_pose{};
  std::array<double, 6> d_point{};
  std::array<double*, 2> jacobians{d_pose.data(), d_point.data()};
  d_pose.fill(1);
  ASSERT_TRUE(
      ReprojectionCost(&camera, {100, 100}, 1).Evaluate(blocks.data(), r.data(), jacobians.data()));
  EXPECT_GE(r[0], 100);
  for (const double v : d_pose) EXPECT_EQ(v, 0);
}

TEST(Costs, AppliedIntrinsicsKeepTheRatio) {
  const Camera camera = test::radtan_camera();
  const IntrinsicsBlock block{std::log(1.1), 0.01, -0.02, -0.2, 0.05, 0.001, 0.002, 0.003};
  const Camera other = apply_intrinsics(camera, block.data());
  EXPECT_NEAR(other.fx_px, 1.1 * camera.fx_px, 1e-9);
  EXPECT_NEAR(other.fx_px / other.fy_px, camera.fx_px / camera.fy_px, 1e-12);
  EXPECT_NEAR(other.cx_px, camera.cx_px + 0.01 * camera.fx_px, 1e-9);
  EXPECT_NEAR(other.cy_px, camera.cy_px - 0.02 * camera.fx_px, 1e-9);
  EXPECT_EQ(other.distortion[0], -0.2);
  EXPECT_EQ(other.distortion[4], 0.003);
  const IntrinsicsBlock back = intrinsics_block(other, camera);
  for (std::size_t i = 0; i < block.size(); ++i) EXPECT_NEAR(back[i], block[i], 1e-12);
}

}  // namespace
}  // namespace corvid
