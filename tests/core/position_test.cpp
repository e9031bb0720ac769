#include "corvid/position.h"

#include <gtest/gtest.h>

#include <limits>
#include <thread>

#include "core/geodesy.h"
#include "corvid/run_result.h"

namespace corvid {
namespace {

// A degree of latitude at the equator is 110 574 m, one of longitude 111 320 m.
TEST(LocalFrame, IsEastNorthUp) {
  const LocalFrame frame({0, 30, 100});
  const auto enu = [&](double latitude, double longitude, double altitude) {
    return frame.to_enu(to_ecef({latitude, longitude, altitude}));
  };
  EXPECT_LT(enu(0, 30, 100).norm(), 1e-8);
  EXPECT_LT((enu(0, 30.001, 100) - Eigen::Vector3d(111.322, 0, 0)).norm(), 0.01);
  EXPECT_LT((enu(0.001, 30, 100) - Eigen::Vector3d(0, 110.576, 0)).norm(), 0.01);
  EXPECT_LT((enu(0, 30, 107) - Eigen::Vector3d(0, 0, 7)).norm(), 1e-8);
}

TEST(LocalFrame, GoesBackToWhereItCameFrom) {
  for (const GeodeticPosition& p :
       {GeodeticPosition{89.99999, 12, 3000}, {-47.4, -179.9999, -20}, {0, 0, 0}}) {
    const LocalFrame frame(p);
    const Eigen::Vector3d enu(1000, -2000, 300);
    const GeodeticPosition back = to_geodetic(frame.to_ecef(enu));
    EXPECT_LT((frame.to_enu(to_ecef(back)) - enu).norm(), 1e-6);
  }
}

TEST(PositionFix, NamesItsProblem) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(PositionFix().problem(), "");
  PositionFix fix;
  fix.position.altitude_m = nan;
  EXPECT_NE(fix.problem(), "");
  fix = {};
  fix.position.latitude_deg = -90.1;
  EXPECT_NE(fix.problem(), "");
  fix = {};
  fix.position.longitude_deg = std::numeric_limits<double>::infinity();
  EXPECT_NE(fix.problem(), "");
  fix = {};
  fix.covariance_m2(0, 1) = 30;
  EXPECT_NE(fix.problem(), "");
  fix.covariance_m2.setZero();
  EXPECT_NE(fix.problem(), "");
  fix.covariance_m2.setConstant(nan);
  EXPECT_NE(fix.problem(), "");
}

TEST(PositionFeed, TakesFromManyThreadsAndRefusesTheUseless) {
  PositionFeed feed;
  std::vector<PositionFix> taken;
  {
    std::vector<std::jthread> threads;
    for (int t = 0; t < 4; ++t) {
      threads.emplace_back([&feed, t] {
        for (int i = 0; i < 250; ++i) {
          PositionFix fix;
          fix.time_ns = 1000 * t + i;
          EXPECT_TRUE(feed.push(fix));
        }
      });
    }
    while (taken.size() < 100) {
      const auto some = feed.take();
      taken.insert(taken.end(), some.begin(), some.end());
    }
  }
  const auto rest = feed.take();
  EXPECT_EQ(taken.size() + rest.size(), 1000U);
  EXPECT_TRUE(feed.take().empty());
  PositionFix bad;
  bad.position.latitude_deg = 100;
  const auto pushed = feed.push(bad);
  ASSERT_FALSE(pushed);
  EXPECT_EQ(pushed.error().code, ErrorCode::invalid_argument);
  EXPECT_TRUE(feed.take().empty());
}

/// Two segments; the second has no scale of its own.
RunResult two_segments() {
  RunResult result;
  auto map = std::make_shared<MapSnapshot>();
  std::vector<Landmark> landmarks;
  for (int i = 0; i < 4; ++i) {
    auto frame = std::make_shared<Frame>();
    frame->time_ns = 100 * i;
    auto keyframe = std::make_shared<Keyframe>();
    keyframe->id = KeyframeId(static_cast<std::uint32_t>(i));
    keyframe->segment = i / 3;
    keyframe->frame = std::make_shared<const StoredFrame>(frame);
    keyframe->T_world_camera = Pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(i, 0, 0));
    keyframe->observations.push_back({LandmarkId(static_cast<std::uint32_t>(i)), {}});
    map->keyframes.push_back(keyframe);
    Landmark landmark;
    landmark.id = LandmarkId(static_cast<std::uint32_t>(i));
    landmark.p_world = {double(i), 1, 0};
    landmarks.push_back(landmark);
    result.trajectory.push_back({frame->time_ns, keyframe->T_world_camera});
    result.trajectory_segments.push_back(keyframe->segment);
  }
  map->landmarks = Landmarks(landmarks);
  result.map = map;
  DepthMap depth;
  depth.keyframe = KeyframeId(1);
  depth.depth = FloatImage(2, 2);
  depth.depth(1, 1) = 4;
  result.depth_maps.emplace_back(depth);
  result.mesh.vertices.emplace_back(0.0F, 0.0F, 1.0F);
  result.mesh.normals.emplace_back(0.0F, 0.0F, 1.0F);
  result.mesh.triangles.push_back({0, 0, 0});
  result.voxel_size = 0.5;
  result.placements.resize(2);
  return result;
}

TEST(PlaceOnEarth, MovesEverythingOnce) {
  RunResult result = two_segments();
  EXPECT_FALSE(place_on_earth(result)) << "nothing is metric";
  EXPECT_EQ(result.trajectory[1].T_world_camera.translation().x(), 1);
  result.placements[0].scale = MapScale::metric;
  result.placements[0].origin = {47, 8, 400};
  const Sim3 T(2, so3_exp({0, 0, 1.5707963267948966}), {10, 0, 0});
  result.placements[0].T_enu_map = T;
  ASSERT_TRUE(place_on_earth(result));
  EXPECT_FALSE(place_on_earth(result)) << "it was done";
  EXPECT_EQ(result.enu_origin->altitude_m, 400);
  for (std::size_t i = 0; i < 4; ++i) {
    const Eigen::Vector3d expected = T * Eigen::Vector3d(double(i), 0, 0);
    EXPECT_LT((result.trajectory[i].T_world_camera.translation() - expected).norm(), 1e-12);
    EXPECT_LT((result.map->keyframes[i]->T_world_camera.translation() - expected).norm(), 1e-12);
    const Landmark& landmark = *result.map->find(LandmarkId(static_cast<std::uint32_t>(i)));
    EXPECT_LT((landmark.p_world - T * Eigen::Vector3d(double(i), 1, 0)).norm(), 1e-12);
  }
  EXPECT_FLOAT_EQ(result.depth_maps[0].load().depth(1, 1), 8);
  EXPECT_LT((result.mesh.vertices[0] - Eigen::Vector3f(10, 0, 2)).norm(), 1e-5F);
  EXPECT_LT((result.mesh.normals[0] - Eigen::Vector3f(0, 0, 1)).norm(), 1e-5F);
  EXPECT_EQ(result.voxel_size, 1);
  ASSERT_EQ(result.notes.size(), 2U) << "the segment without a scale, and the mesh";
}

TEST(PlaceOnEarth, FramesBeforeASegmentsFirstKeyframeGoWithIt) {
  RunResult result = two_segments();
  // Between the last keyframe of the one and the first of the other.
  result.trajectory.insert(result.trajectory.begin() + 3, {250, Pose()});
  result.trajectory_segments.insert(result.trajectory_segments.begin() + 3, 1);
  for (const int s : {0, 1}) {
    MapPlacement& placement = result.placements[static_cast<std::size_t>(s)];
    placement.scale = MapScale::metric;
    placement.T_enu_map = Sim3(1, Eigen::Quaterniond::Identity(), {0, 100.0 * s, 0});
  }
  ASSERT_TRUE(place_on_earth(result));
  EXPECT_EQ(result.trajectory[2].T_world_camera.translation().y(), 0);
  EXPECT_EQ(result.trajectory[3].T_world_camera.translation().y(), 100);
  EXPECT_EQ(result.trajectory[4].T_world_camera.translation().y(), 100);
}

}  // namespace
}  // namespace corvid
