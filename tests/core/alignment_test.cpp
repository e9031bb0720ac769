#include "core/alignment.h"

#include <gtest/gtest.h>

#include <limits>
#include <random>
#include <vector>

#include "oracle/finite_difference.h"

namespace corvid {
namespace {

using Points = std::vector<Eigen::Vector3d>;

Points random_points(std::mt19937& rng, int n, double size) {
  Points points;
  for (int i = 0; i < n; ++i) points.push_back(test::random_vector<3>(rng, size));
  return points;
}
Points moved(const Sim3& T, const Points& points) {
  Points out;
  for (const auto& p : points) out.push_back(T * p);
  return out;
}
double squares(const Sim3& T, const Points& source, const Points& target) {
  double sum = 0;
  for (std::size_t i = 0; i < source.size(); ++i) sum += (T * source[i] - target[i]).squaredNorm();
  return sum;
}

TEST(Alignment, FindsThePlantedSimilarity) {
  std::mt19937 rng(3);
  for (int i = 0; i < 20; ++i) {
    const Sim3 T = Sim3::exp(test::random_vector<7>(rng, 2));
    const Points source = random_points(rng, 3 + i, 10);
    const auto found = align_points(source, moved(T, source), true);
    ASSERT_TRUE(found.ok());
    EXPECT_LT((found.T_target_source * T.inverse()).log().norm(), 1e-9);
    EXPECT_LT(found.rmse, 1e-10 * T.scale());
  }
}

TEST(Alignment, FindsThePlantedRigidMotionAndKeepsTheScale) {
  std::mt19937 rng(4);
  const Sim3 T(1, so3_exp({0.3, 2, -1}), {5, 6, -7});
  const Points source = random_points(rng, 30, 10);
  const auto found = align_points(source, moved(T, source), false);
  ASSERT_TRUE(found.ok());
  EXPECT_LT((found.T_target_source * T.inverse()).log().norm(), 1e-10);
  const Sim3 twice(2, T.rotation(), T.translation());
  const auto rigid = align_points(source, moved(twice, source), false);
  ASSERT_TRUE(rigid.ok());
  EXPECT_EQ(rigid.T_target_source.scale(), 1);
  EXPECT_GT(rigid.rmse, 1);
}

TEST(Alignment, IsTheLeastSquaresOptimum) {
  std::mt19937 rng(5);
  const Points source = random_points(rng, 40, 5);
  Points target = moved(Sim3::exp(test::random_vector<7>(rng, 1)), source);
  for (auto& p : target) p += test::random_vector<3>(rng, 0.5);
  const auto found = align_points(source, target, true);
  ASSERT_TRUE(found.ok());
  const double best = squares(found.T_target_source, source, target);
  EXPECT_NEAR(found.rmse, std::sqrt(best / 40), 1e-12);
  for (int i = 0; i < 200; ++i) {
    const Sim3 other = found.T_target_source * Sim3::exp(test::random_vector<7>(rng, 1e-2));
    EXPECT_GT(squares(other, source, target), best);
  }
}

TEST(Alignment, NeverMirrors) {
  std::mt19937 rng(6);
  const Points source = random_points(rng, 30, 5);
  Points target = source;
  for (auto& p : target) p.z() = -p.z();
  const auto found = align_points(source, target, true);
  ASSERT_TRUE(found.ok());
  EXPECT_NEAR(found.T_target_source.rotation().toRotationMatrix().determinant(), 1, 1e-12);
  EXPECT_GT(found.rmse, 0.5);
}

TEST(Alignment, PlanarPointsAreEnough) {
  std::mt19937 rng(7);
  Points source = random_points(rng, 30, 5);
  for (auto& p : source) p.z() = 1;
  const Sim3 T = Sim3::exp(test::random_vector<7>(rng, 2));
  const auto found = align_points(source, moved(T, source), true);
  ASSERT_TRUE(found.ok());
  EXPECT_LT((found.T_target_source * T.inverse()).log().norm(), 1e-9);
}

TEST(Alignment, RefusesWhatHasNoUniqueAnswer) {
  const Points two{{0, 0, 0}, {1, 0, 0}};
  EXPECT_EQ(align_points(two, two, true).status, AlignmentStatus::too_few);
  EXPECT_EQ(align_points({}, {}, true).status, AlignmentStatus::too_few);
  std::mt19937 rng(8);
  const Points many = random_points(rng, 10, 1);
  EXPECT_EQ(align_points(many, two, true).status, AlignmentStatus::too_few);

  Points line, place(10, Eigen::Vector3d(0.1, -2.3, 1e6 / 3));
  for (int i = 0; i < 10; ++i) line.emplace_back(100 + 0.3 * i, 50 - 0.1 * i, 7 + 0.7 * i);
  for (const bool with_scale : {false, true}) {
    EXPECT_EQ(align_points(line, many, with_scale).status, AlignmentStatus::degenerate);
    EXPECT_EQ(align_points(many, line, with_scale).status, AlignmentStatus::degenerate);
    EXPECT_EQ(align_points(place, many, with_scale).status, AlignmentStatus::degenerate);
  }
  Points broken = many;
  broken[3].y() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(align_points(broken, many, true).status, AlignmentStatus::not_finite);
  EXPECT_EQ(align_points(many, broken, true).status, AlignmentStatus::not_finite);
  EXPECT_EQ(align_points(many, broken, true).T_target_source.log().norm(), 0);
}

}  // namespace
}  // namespace corvid
