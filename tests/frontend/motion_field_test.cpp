#include "frontend/motion_field.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>

namespace corvid {
namespace {

struct Field {
  Eigen::Matrix2d linear;
  Eigen::Vector2d shift{12, -7};
  std::vector<Eigen::Vector2d> from, to;

  explicit Field(const Eigen::Matrix2d& A, int count = 300, double noise_px = 0) : linear(A) {
    std::mt19937 random(5);
    std::uniform_real_distribution<double> place(0, 400), error(-noise_px, noise_px);
    for (int i = 0; i < count; ++i) {
      from.emplace_back(place(random), place(random));
      to.push_back(linear * from.back() + shift + Eigen::Vector2d(error(random), error(random)));
    }
  }
};

Eigen::Matrix2d some_affinity() {
  Eigen::Matrix2d A;
  A << 1.1, -0.3, 0.25, 0.9;
  return A;
}

TEST(MotionField, GivesAnAffinityBack) {
  const Field f(some_affinity());
  const MotionField field(f.from, f.to, some_affinity());
  const Eigen::Vector2d x(200, 150);
  const LocalMotion motion = field.at(x);
  EXPECT_LT((motion.x_t - (f.linear * x + f.shift)).norm(), 1e-9);
  EXPECT_LT((motion.linear - f.linear).norm(), 1e-9);
  EXPECT_LT(motion.spread_px, 1e-9);
}

TEST(MotionField, IsDrawnToThePriorOnlyALittle) {
  const Field f(some_affinity());
  const MotionField field(f.from, f.to, Eigen::Matrix2d::Identity());
  EXPECT_LT((field.at(Eigen::Vector2d(200, 150)).linear - f.linear).norm(), 0.06);
}

TEST(MotionField, OneWrongNeighbourInFourDoesNotMoveIt) {
  Field f(some_affinity(), 400, 0.1);
  std::mt19937 random(9);
  for (std::size_t i = 0; i < f.to.size(); i += 4)
    f.to[i] += Eigen::Vector2d(30.0 + static_cast<double>(random() % 40), -25);
  const MotionField field(f.from, f.to, some_affinity());
  std::vector<Eigen::Vector2d> places;
  for (int y = 60; y < 340; y += 20)
    for (int x = 60; x < 340; x += 20) places.emplace_back(x, y);
  const auto motions = field.at(places);
  int good = 0;
  for (std::size_t i = 0; i < places.size(); ++i)
    good += (motions[i].x_t - (f.linear * places[i] + f.shift)).norm() < 1.5;
  EXPECT_GT(good, static_cast<int>(0.9 * static_cast<double>(places.size())));
}

TEST(MotionField, AgreementFindsWhatMovedAlone) {
  Field f(Eigen::Matrix2d::Identity(), 200);
  f.to[17] += Eigen::Vector2d(40, 0);
  f.to[90] += Eigen::Vector2d(0, -60);
  const auto agreement = MotionField(f.from, f.to, Eigen::Matrix2d::Identity()).agreement(0.1, 1.0);
  for (std::size_t i = 0; i < agreement.size(); ++i) {
    if (i == 17 || i == 90)
      EXPECT_EQ(agreement[i], 0);
    else
      EXPECT_GE(agreement[i], 6);
  }
}

TEST(MotionField, RangeCoversTheNeighboursDepths) {
  // Left half near (moves by 20 along x), right half far (moves by 2).
  std::vector<Eigen::Vector2d> from, to;
  for (int y = 0; y < 100; y += 10)
    for (int x = 0; x < 200; x += 10) {
      from.emplace_back(x, y);
      to.emplace_back(x + (x < 100 ? 20 : 2), y);
    }
  const MotionField field(from, to, Eigen::Matrix2d::Identity());
  const Eigen::Vector2d x(98, 50), along = Eigen::Vector2d::UnitX();
  const LocalMotion motion = field.at(x);
  const auto [least, most] = field.range_along(x, motion, along);
  EXPECT_LE(motion.x_t.x() + least, 98 + 2 + 1.0);
  EXPECT_GE(motion.x_t.x() + most, 98 + 20 - 2.0);
}

TEST(MotionField, FewAndEqualPointsGiveFiniteAnswers) {
  for (std::size_t count : {1U, 2U, 3U, 40U}) {
    const std::vector<Eigen::Vector2d> same(count, Eigen::Vector2d(5, 5));
    const MotionField field(same, same, Eigen::Matrix2d::Identity());
    for (const auto& x : {Eigen::Vector2d(5, 5), Eigen::Vector2d(1e4, -1e4)}) {
      const LocalMotion motion = field.at(x);
      EXPECT_TRUE(motion.x_t.allFinite() && motion.linear.allFinite());
    }
    EXPECT_EQ(field.agreement(0.1, 1).size(), count);
  }
}

}  // namespace
}  // namespace corvid
