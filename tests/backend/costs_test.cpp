#include <gtest/gtest.h>

#include <fmt/format.h>
#include <numbers>
#include <random>

#include "backend/costs/position.h"
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
      const auto differences = [&](double step) {
        const auto plus = residuals_at(cost, moved(blocks, b, c, step));
        const auto minus = residuals_at(cost, moved(blocks, b, c, -step));
        Eigen::VectorXd d(rows);
        for (int i = 0; i < rows; ++i) {
          const auto row = static_cast<std::size_t>(i);
          d(i) = (plus[row] - minus[row]) / (2 * step);
        }
        return d;
      };
      // What another step changes is the difference's own error.
      const Eigen::VectorXd numeric = differences(kStep), wider = differences(2 * kStep);
      for (int i = 0; i < rows; ++i) {
        const auto row = static_cast<std::size_t>(i);
        const double analytic = storage[b][row * blocks[b].size() + static_cast<std::size_t>(c)];
        EXPECT_NEAR(analytic, numeric(i),
                    tolerance * (1 + std::abs(numeric(i))) + 2 * std::abs(wider(i) - numeric(i)))
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

/// Whether the camera model holds at the blocks and within a step of them, nowhere there, or
/// neither.
enum class Holds { everywhere, nowhere, partly };
Holds holds(const Camera& reference, const Blocks& blocks) {
  constexpr double kReach = 1e-4;
  int valid = 0, all = 0;
  const auto look = [&](const Blocks& b) {
    const Camera camera = b.size() > 2 ? apply_intrinsics(reference, b[2].data()) : reference;
    const Eigen::Vector3d p(b[1][0], b[1][1], b[1][2]);
    valid += camera.project(from_block(b[0].data()).inverse() * p) ? 1 : 0;
    ++all;
  };
  look(blocks);
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    const int columns = b == 0 ? 6 : static_cast<int>(blocks[b].size());
    for (int c = 0; c < columns; ++c)
      for (const double step : {kReach, -kReach}) look(moved(blocks, b, c, step));
  }
  return valid == all ? Holds::everywhere : valid == 0 ? Holds::nowhere : Holds::partly;
}

/// Beyond the model nothing is pulled, and nothing is NaN.
void check_flat(const ceres::CostFunction& cost, const Blocks& blocks, bool partly) {
  std::vector<const double*> pointers;
  std::vector<std::vector<double>> storage;
  std::vector<double*> jacobians;
  for (const auto& b : blocks) {
    pointers.push_back(b.data());
    storage.emplace_back(2 * b.size(), 7.0);
  }
  for (auto& s : storage) jacobians.push_back(s.data());
  std::array<double, 2> r{};
  ASSERT_TRUE(cost.Evaluate(pointers.data(), r.data(), jacobians.data()));
  EXPECT_TRUE(std::isfinite(r[0]) && std::isfinite(r[1]));
  for (const auto& s : storage)
    for (const double v : s) {
      EXPECT_TRUE(std::isfinite(v));
      if (!partly) {
        EXPECT_EQ(v, 0);
      }
    }
  if (!partly) {
    EXPECT_GE(std::min(r[0], r[1]), 100);
  }
}

TEST(Costs, JacobiansOverAGridThatCrossesTheEdgesOfTheModels) {
  std::mt19937_64 random(6);
  Camera folding = test::radtan_camera();
  folding.distortion = {-0.4, 0.02, 0.003, -0.002, 0};
  Camera fish = test::equidistant_camera();
  fish.distortion = {-0.1, -0.02, 0, 0, 0};
  for (const Camera& camera : {test::pinhole_camera(), test::radtan_camera(), folding,
                               test::equidistant_camera(), fish, test::fov_camera()}) {
    SCOPED_TRACE(fmt::format("{} {}", to_string(camera.model), camera.distortion[0]));
    int inside = 0, outside = 0;
    for (double off_axis_deg = -175; off_axis_deg <= 175; off_axis_deg += 6.25) {
      for (const double turn_rad : {0.0, 0.7, 1.9}) {
        for (const double range : {0.02, 3.0, 500.0}) {
          const double a = off_axis_deg * std::numbers::pi / 180;
          const Eigen::Vector3d ray(std::sin(a) * std::cos(turn_rad),
                                    std::sin(a) * std::sin(turn_rad), std::cos(a));
          const auto pose = random_pose(random);
          const Eigen::Vector3d p = from_block(pose.data()) * Eigen::Vector3d(range * ray);
          Blocks blocks = {pose, {p.x(), p.y(), p.z()}};
          const ReprojectionCost cost(&camera, {300, 200}, 1.3);
          const IntrinsicsReprojectionCost with(&camera, {300, 200}, 0.6);
          for (const bool intrinsics : {false, true}) {
            const ceres::CostFunction& tried =
                intrinsics ? static_cast<const ceres::CostFunction&>(with) : cost;
            if (intrinsics) {
              const IntrinsicsBlock k = intrinsics_block(camera, camera);
              blocks.emplace_back(k.begin(), k.end());
            }
            const Holds h = holds(camera, blocks);
            if (h != Holds::everywhere) {
              check_flat(tried, blocks, h == Holds::partly);
              ++outside;
            } else if (const auto r = residuals_at(tried, blocks);
                       range > 0.1 && std::max(std::abs(r[0]), std::abs(r[1])) < 1e4) {
              // Nearer, and farther out, a difference is all curvature and rounding.
              check_jacobians(tried, blocks, 1e-4);
              ++inside;
            }
            if (HasFailure()) return;
          }
        }
      }
    }
    EXPECT_GE(inside, 20);
    const bool ends = !camera.project({0.05, 0, -1});
    EXPECT_GE(outside, ends ? 20 : 0);
  }
}

TEST(Costs, JacobiansOfTheGaugeAndThePrior) {
  std::mt19937_64 random(4);
  for (int trial = 0; trial < 20; ++trial) {
    check_jacobians(DistanceCost(0.7, 3), {random_pose(random), random_pose(random)}, 1e-6);
    Eigen::Matrix3d sqrt_information;
    sqrt_information << 2, 0.1, 0, 0, 3, -0.4, 0, 0, 0.5;
    check_jacobians(PositionCost({0.3, -5, 2}, sqrt_information), {random_pose(random)}, 1e-6);
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
