#include "backend/geo_alignment.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <random>

namespace corvid {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

const Sim3& truth() {
  static const Sim3 T(3.7, so3_exp({0.4, -1.1, 2.0}), {12, -40, 7});
  return T;
}

/// A winding path seen by a receiver; noise of sigma_m on each axis.
struct Path {
  int points = 60;
  double lateral = 4;  // of the path's bends [map units]
  double length = 30;  // [map units]
  double sigma_m = 0.3;
  double outliers = 0;
  std::uint64_t seed = 3;

  [[nodiscard]] std::vector<PlacedPoint> fly() const {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    std::uniform_real_distribution<double> uniform(0, 1);
    std::vector<PlacedPoint> out;
    for (int i = 0; i < points; ++i) {
      const double s = i / std::max(1.0, points - 1.0);
      PlacedPoint p;
      p.p_map = {length * s, lateral * std::sin(5 * s), 0.5 * lateral * std::cos(8 * s)};
      p.p_enu_m = truth() * p.p_map +
                  sigma_m * Eigen::Vector3d(normal(random), normal(random), normal(random));
      if (uniform(random) < outliers) {
        p.p_enu_m += 200 * Eigen::Vector3d(uniform(random) - 0.5, uniform(random) - 0.5, 1);
      }
      p.covariance_m2 = sigma_m * sigma_m * Eigen::Matrix3d::Identity();
      out.push_back(p);
    }
    return out;
  }
};

TEST(GeoAlignment, FindsTheSimilarityAmongThirtyPercentOfOutliers) {
  Path path;
  path.outliers = 0.3;
  const auto points = path.fly();
  const GeoAlignment a = align_to_positions(points, {});
  ASSERT_TRUE(a.ok()) << a.reason;
  EXPECT_TRUE(a.reason.empty());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double error_m = (truth() * points[i].p_map - points[i].p_enu_m).norm();
    EXPECT_EQ(a.inlier[i] != 0, error_m < 10) << error_m;
  }
  const Vector7d error = (a.T_enu_map.inverse() * truth()).log();
  EXPECT_LT(std::abs(error(6)), 0.01);
  EXPECT_LT(error.segment<3>(3).norm(), 0.05);
}

// The covariance is that of the estimate: normalised squared errors have a mean of 7.
TEST(GeoAlignment, CovarianceFitsTheErrors) {
  double sum = 0;
  constexpr int kRuns = 60;
  for (int run = 0; run < kRuns; ++run) {
    Path path;
    path.seed = 100 + static_cast<std::uint64_t>(run);
    path.sigma_m = 1;
    const GeoAlignment a = align_to_positions(path.fly(), {});
    ASSERT_TRUE(a.ok()) << a.reason;
    const Vector7d error = (a.T_enu_map.inverse() * truth()).log();
    sum += error.dot(a.covariance.ldlt().solve(error));
  }
  EXPECT_GT(sum / kRuns, 3);
  EXPECT_LT(sum / kRuns, 9);
}

TEST(GeoAlignment, StraightPathWaits) {
  for (const double lateral : {0.0, 0.01}) {
    Path path;
    path.lateral = lateral;
    for (const double sigma_m : {1e-3, 0.3}) {
      path.sigma_m = sigma_m;
      if (lateral > 0 && sigma_m < 0.1) continue;  // that can be seen
      const GeoAlignment a = align_to_positions(path.fly(), {});
      EXPECT_EQ(a.status, GeoAlignmentStatus::too_straight)
          << lateral << " " << sigma_m << a.reason;
      EXPECT_FALSE(a.reason.empty());
      EXPECT_EQ(a.T_enu_map.scale(), 1);
    }
  }
}

TEST(GeoAlignment, ShortPathWaits) {
  Path path;
  path.length = 1;
  path.lateral = 0.5;
  path.sigma_m = 2;
  EXPECT_EQ(align_to_positions(path.fly(), {}).status, GeoAlignmentStatus::too_short);
}

TEST(GeoAlignment, BadInputHasADefinedAnswer) {
  EXPECT_EQ(align_to_positions({}, {}).status, GeoAlignmentStatus::too_few);
  Path path;
  auto points = path.fly();
  EXPECT_EQ(align_to_positions(std::span(points).first(5), {}).status, GeoAlignmentStatus::too_few);
  // All in one place.
  std::vector<PlacedPoint> same(50, points[0]);
  EXPECT_FALSE(align_to_positions(same, {}).ok());
  for (PlacedPoint& p : same) p = PlacedPoint{};
  EXPECT_FALSE(align_to_positions(same, {}).ok());
  // NaN among good ones, in places and in covariances.
  points[3].p_enu_m.x() = kNaN;
  points[4].p_map.z() = std::numeric_limits<double>::infinity();
  points[5].covariance_m2.setConstant(kNaN);
  points[6].covariance_m2.setZero();
  const GeoAlignment a = align_to_positions(points, {}, Sim3());
  ASSERT_TRUE(a.ok()) << a.reason;
  for (const std::size_t i : {3U, 4U, 5U, 6U}) EXPECT_EQ(a.inlier[i], 0);
  for (PlacedPoint& p : points) p.p_map.setConstant(kNaN);
  EXPECT_EQ(align_to_positions(points, {}).status, GeoAlignmentStatus::too_few);
}

TEST(GeoAlignment, PositionsThatHaveNothingToDoWithThePathAreRefused) {
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> uniform(-100, 100);
  auto points = Path{}.fly();
  for (PlacedPoint& p : points) p.p_enu_m = {uniform(random), uniform(random), uniform(random)};
  const GeoAlignment a = align_to_positions(points, {});
  EXPECT_EQ(a.status, GeoAlignmentStatus::inconsistent) << a.reason;
  EXPECT_EQ(a.inliers, 0);
}

// Errors that wander make a worse similarity than independent ones: the claim must say so.
TEST(GeoAlignment, WanderingErrorsClaimLess) {
  Path path;
  path.points = 200;
  auto points = path.fly();
  const double independent = align_to_positions(points, {}).covariance(6, 6);
  std::mt19937_64 random(9);
  std::normal_distribution<double> normal;
  Eigen::Vector3d error = Eigen::Vector3d::Zero();
  for (PlacedPoint& p : points) {
    error = 0.95 * error + 0.3 * std::sqrt(1 - 0.95 * 0.95) *
                               Eigen::Vector3d(normal(random), normal(random), normal(random));
    p.p_enu_m = truth() * p.p_map + error;
  }
  const GeoAlignment a = align_to_positions(points, {});
  ASSERT_TRUE(a.ok()) << a.reason;
  EXPECT_GT(a.covariance(6, 6), 4 * independent);
}

}  // namespace
}  // namespace corvid
