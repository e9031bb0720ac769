#include "mapping/depth_clean.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "scenes/plane_views.h"

namespace corvid {
namespace {

/// A map of one depth everywhere.
DepthMap flat(float depth) {
  DepthMap map;
  map.camera = testing::pinhole(40, 30, 40);
  map.depth = FloatImage(40, 30, depth);
  map.confidence = FloatImage(40, 30, 0.8F);
  return map;
}

int answers(const DepthMap& map) {
  return static_cast<int>(std::count_if(map.depth.data(), map.depth.data() + map.depth.size(),
                                        [](float z) { return z > 0; }));
}

TEST(DepthClean, SmallIslandsGoAndLargeOnesStay) {
  DepthMap map = flat(0);
  for (int y = 5; y < 15; ++y) {
    for (int x = 5; x < 15; ++x) map.depth(x, y) = 5 + 0.01F * static_cast<float>(x + y);
  }
  for (int x = 15; x < 19; ++x) map.depth(x, 7) = 8;  // touches, but at another depth
  map.depth(30, 20) = 5;
  EXPECT_EQ(remove_speckles(map, 10), 5);
  EXPECT_EQ(answers(map), 100);
  EXPECT_EQ(map.confidence(30, 20), 0);
  EXPECT_EQ(map.depth(16, 7), 0);
}

TEST(DepthClean, PointsThatAWitnessSeesThroughGo) {
  DepthMap map = flat(5);
  for (int y = 10; y < 15; ++y) {
    for (int x = 10; x < 15; ++x) map.depth(x, y) = 2;  // floats in front
  }
  for (int y = 10; y < 15; ++y) {
    for (int x = 20; x < 25; ++x) map.depth(x, y) = 9;  // behind: the witness cannot judge
  }
  const DepthMap witness = flat(5);
  const std::vector<DepthWitness> witnesses{{&witness, Pose()}};
  EXPECT_EQ(remove_contradicted(map, witnesses), 25);
  EXPECT_EQ(map.depth(12, 12), 0);
  EXPECT_EQ(map.depth(22, 12), 9);
  EXPECT_EQ(map.depth(5, 5), 5);
  EXPECT_EQ(remove_contradicted(map, {}), 0);
}

TEST(DepthClean, AConfirmedPointStaysAndAWitnessThatLooksAwayKnowsNothing) {
  DepthMap map = flat(2);
  const DepthMap far = flat(5), same = flat(2);
  const std::vector<DepthWitness> both{{&far, Pose()}, {&same, Pose()}};
  EXPECT_EQ(remove_contradicted(map, both), 0);
  const Pose away(so3_exp({0, 3.1, 0}), Eigen::Vector3d::Zero());
  const std::vector<DepthWitness> blind{{&far, away}};
  EXPECT_EQ(remove_contradicted(map, blind), 0);
}

TEST(DepthClean, RaysWithTwoEqualPeaksLoseTheirAnswer) {
  DepthMap map = flat(2);
  FloatImage lead(40, 30, 0.5F);
  lead(3, 4) = 0.001F;
  lead(5, 6) = 0.05F;
  weaken_ambiguous(map, lead);
  EXPECT_EQ(answers(map), 40 * 30 - 1);
  EXPECT_EQ(map.depth(3, 4), 0);
  EXPECT_LT(map.confidence(5, 6), 0.7F);
  EXPECT_GT(map.confidence(5, 6), 0.4F);
  EXPECT_FLOAT_EQ(map.confidence(0, 0), 0.8F);
}

}  // namespace
}  // namespace corvid
