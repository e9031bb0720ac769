#include "core/associate.h"

#include <gtest/gtest.h>

#include <cmath>

#include <numbers>

namespace corvid {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180;
constexpr std::int64_t kMs = 1'000'000;

Eigen::Quaterniond yaw(double deg) { return so3_exp({0, 0, deg * kRadPerDeg}); }

TEST(Associate, TakesTheNearestWithinReach) {
  const Trajectory truth{{0, {}}, {100 * kMs, {}}, {200 * kMs, {}}};
  const Trajectory estimate{{10 * kMs, {}}, {89 * kMs, {}}, {195 * kMs, {}}, {300 * kMs, {}}};
  const auto pairs = associate(estimate, truth);
  ASSERT_EQ(pairs.size(), 2u);
  EXPECT_EQ(pairs[0].estimate_index, 0u);
  EXPECT_EQ(pairs[1].estimate_index, 2u);
  EXPECT_FALSE(pairs[0].interpolated);
  EXPECT_EQ(associate(estimate, truth, 0.02).size(), 3u);
  EXPECT_EQ(associate(estimate, truth, 0.001).size(), 0u);
}

TEST(Associate, InterpolatesATruthOfHigherRate) {
  const Trajectory truth{{0, Pose(yaw(10), Eigen::Vector3d(1, 0, 0))},
                         {8 * kMs, Pose(yaw(30), Eigen::Vector3d(3, 4, 0))}};
  const auto pairs = associate({{2 * kMs, {}}}, truth);
  ASSERT_EQ(pairs.size(), 1u);
  EXPECT_TRUE(pairs[0].interpolated);
  EXPECT_LT((pairs[0].truth.translation() - Eigen::Vector3d(1.5, 1, 0)).norm(), 1e-12);
  EXPECT_NEAR(so3_log(pairs[0].truth.rotation()).z() / kRadPerDeg, 15, 1e-9);
  // At a true pose's own time, that pose.
  const auto exact = associate({{8 * kMs, {}}}, truth);
  ASSERT_EQ(exact.size(), 1u);
  EXPECT_FALSE(exact[0].interpolated);
  EXPECT_EQ(exact[0].truth.translation(), Eigen::Vector3d(3, 4, 0));
}

TEST(Associate, UsesEachTruePoseOnce) {
  const Trajectory truth{{0, {}}, {100 * kMs, {}}};
  const Trajectory estimate{{95 * kMs, {}}, {99 * kMs, {}}, {103 * kMs, {}}};
  const auto pairs = associate(estimate, truth);
  ASSERT_EQ(pairs.size(), 1u);
  EXPECT_EQ(pairs[0].estimate_index, 1u);
}

TEST(Associate, TruePosesLeaveOutWhatIsMissingOrNotFinite) {
  Trajectory truth;
  for (std::int64_t i = 0; i < 4; ++i)
    truth.push_back({i * 1'000'000'000, Pose(Eigen::Matrix3d::Identity(),
                                             Eigen::Vector3d(static_cast<double>(i), 0, 0))});
  truth[2].T_world_camera = Pose(Eigen::Matrix3d::Identity(), Eigen::Vector3d(std::nan(""), 0, 0));
  const std::vector<std::int64_t> times_ns{0, 1'000'000'000, 2'000'000'000, 9'000'000'000};
  const auto poses = true_poses(times_ns, truth);
  ASSERT_EQ(poses.size(), 4U);
  ASSERT_TRUE(poses[1]);
  EXPECT_NEAR(poses[1]->translation().x(), 1, 1e-12);
  EXPECT_FALSE(poses[2]);
  EXPECT_FALSE(poses[3]);
}

}  // namespace
}  // namespace corvid
