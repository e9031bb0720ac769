#include "mapping/view_choice.h"

#include <gtest/gtest.h>

#include "scenes/true_map.h"

namespace corvid {
namespace {

using testing::PlaneScene;

PlaneScene wall() {
  PlaneScene scene;
  scene.planes = {{Eigen::Vector3d(0, 0, 1), 4}};
  return scene;
}

/// Nine views along a wall, 0.2 apart.
MapSnapshot along_the_wall() {
  std::vector<Pose> poses;
  for (int i = 0; i < 9; ++i) {
    poses.emplace_back(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.2 * i, 0, 0));
  }
  return testing::true_map(wall(), testing::pinhole(80, 60, 60), poses);
}

TEST(ViewChoice, TakesViewsFromBothSidesAtAUsefulAngle) {
  const MapSnapshot map = along_the_wall();
  const auto chosen = choose_neighbours(map, 4, {});
  ASSERT_EQ(chosen.size(), 4U);
  EXPECT_LT(chosen[1].index, 4U);
  EXPECT_GT(chosen[2].index, 4U);
  for (const Neighbour& n : chosen) {
    EXPECT_GT(n.angle_rad, 0.03);
    EXPECT_LT(n.angle_rad, 0.2);
    EXPECT_GT(n.overlap, 0.5);
  }
}

TEST(ViewChoice, AtTheEndOfTheFlightOneSideFillsForTheOther) {
  const MapSnapshot map = along_the_wall();
  for (const std::size_t end : {0U, 8U}) {
    const auto chosen = choose_neighbours(map, end, {});
    ASSERT_EQ(chosen.size(), 4U);
    for (const Neighbour& n : chosen) EXPECT_NE(n.index, end);
  }
}

TEST(ViewChoice, IdenticalViewsOtherSegmentsAndViewsWithoutOverlapAreNoNeighbours) {
  const Pose here;
  const Pose away(so3_exp({0, 3.14, 0}), Eigen::Vector3d(0.3, 0, 0));
  const Pose beside(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.3, 0, 0));
  MapSnapshot map =
      testing::true_map(wall(), testing::pinhole(80, 60, 60), {here, here, away, beside});
  auto chosen = choose_neighbours(map, 0, {});
  ASSERT_EQ(chosen.size(), 1U);
  EXPECT_EQ(chosen[0].index, 3U);
  auto other = std::make_shared<Keyframe>(*map.keyframes[3]);
  other->segment = 1;
  map.keyframes[3] = other;
  EXPECT_TRUE(choose_neighbours(map, 0, {}).empty());
}

TEST(ViewChoice, SceneDepthComesFromTheLandmarksInFront) {
  MapSnapshot map = along_the_wall();
  const auto scene = scene_depth(map, *map.keyframes[4]);
  ASSERT_TRUE(scene.has_value());
  EXPECT_NEAR(scene->median, 4, 1e-6);
  EXPECT_NEAR(scene->near, 4, 1e-6);
  EXPECT_NEAR(scene->far, 4, 1e-6);
  auto turned = std::make_shared<Keyframe>(*map.keyframes[4]);
  turned->T_world_camera = Pose(so3_exp({0, 3.14159, 0}), Eigen::Vector3d::Zero());
  EXPECT_FALSE(scene_depth(map, *turned).has_value());
  turned->observations.clear();
  EXPECT_FALSE(scene_depth(map, *turned).has_value());
}

}  // namespace
}  // namespace corvid
