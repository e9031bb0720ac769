// Keyframes on known ground rest.
#include "backend/rest.h"

#include <gtest/gtest.h>

#include "backend/map_edit.h"
#include "tests/backend/simulator.h"

namespace corvid {
namespace {

/// Keyframes 0 and 1 saw 100 points long ago, keyframe 2 sees them again from beside keyframe 0.
struct SeenAgain {
  MapData map;
  std::vector<FrameRecord> frames;
  std::vector<Eigen::Vector3d> points;
  explicit SeenAgain(double beside = 0.05) {
    map.camera = test::pinhole_camera();
    for (int i = 0; i < 100; ++i)
      points.emplace_back(0.4 * (i % 10) - 1.8, 0.3 * (i / 10) - 1.3, 5);
    for (const double x : {0.0, 1.2, beside}) add({Eigen::Quaterniond::Identity(), {x, 0, 0}}, 0);
    for (auto& [id, track] : map.tracks) {
      track.landmark = true;
      track.p_world = points[id.value];
    }
  }
  [[nodiscard]] std::optional<int> known(int older = 2) {
    tie(map, 2, older);
    return known_view(map, 2, older);
  }
  int add(const Pose& T_world_camera, int segment) {
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(map.keyframes.size()));
    std::vector<TrackObservation> seen;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const auto pixel = map.camera.project(T_world_camera.inverse() * points[i]);
      if (pixel && map.camera.in_image(*pixel))
        seen.push_back(
            {TrackId(static_cast<std::uint32_t>(i)), *pixel, 1, Eigen::Matrix2d::Identity()});
    }
    return map.add_keyframe(frame, segment, T_world_camera, seen);
  }
};

TEST(Rest, AViewIsKnownFromNearlyTheSamePlace) {
  EXPECT_EQ(SeenAgain().known(), 0);
  EXPECT_EQ(SeenAgain(1.15).known(), 1);
  EXPECT_EQ(SeenAgain(0.6).known(), std::nullopt) << "55 px from either";
  EXPECT_EQ(SeenAgain(1.15).known(1), std::nullopt) << "keyframe 1 is too new";
  SeenAgain elsewhere;
  elsewhere.map.keyframes[2].segment = 1;
  EXPECT_EQ(elsewhere.known(), std::nullopt) << "another segment";
  SeenAgain resting;
  EXPECT_EQ(known_view(resting.map, 0, 0), std::nullopt) << "the first";
  rest(resting.map, 2, 0, 3);
  EXPECT_EQ(resting.known(), std::nullopt) << "it rests already";
}

TEST(Rest, TheMapMustBeKnownToFitThere) {
  SeenAgain few;
  std::uint32_t i = 0;
  for (auto& [id, track] : few.map.tracks) track.landmark = i++ % 2 == 0;
  EXPECT_EQ(few.known(), std::nullopt) << "50 landmarks in common";
  few.add({Eigen::Quaterniond::Identity(), {0.1, 0, 0}}, 0);
  few.map.keyframes[3].tied = true;
  EXPECT_EQ(few.known(), 0) << "the next keyframe tells";
  few.map.keyframes[3].segment = 1;
  EXPECT_EQ(few.known(), std::nullopt) << "of another segment";
}

TEST(Rest, WhatItSawGoesAndTheRestOfTheMapStays) {
  SeenAgain world;
  MapData& map = world.map;
  const auto track = [&](std::uint32_t id) -> MapTrack* {
    const auto it = map.tracks.find(TrackId(id));
    return it == map.tracks.end() ? nullptr : &it->second;
  };
  const auto own = [&](std::uint32_t id, std::vector<int> seen_in) {
    MapTrack& t = map.tracks[TrackId(id)];
    t.landmark = true;
    t.p_world = {0, 0, 5};
    for (const int k : seen_in)
      add_view(map, k, {TrackId(id), {100, 100}, 1, Eigen::Matrix2d::Identity()});
  };
  own(200, {2});     // nobody else saw it
  own(201, {1, 2});  // one other did, long ago
  const int k = world.add({Eigen::Quaterniond::Identity(), {0.7, 0, 0}}, 0);
  own(202, {2, k});  // is followed still
  (void)map.snapshot(1);
  rest(map, 2, 0, k);
  EXPECT_EQ(track(200), nullptr);
  EXPECT_EQ(track(201), nullptr);
  ASSERT_NE(track(202), nullptr);
  EXPECT_TRUE(track(202)->landmark);
  EXPECT_EQ(track(202)->views.size(), 1U);
  EXPECT_EQ(track(0)->views.size(), 3U);
  EXPECT_TRUE(track(0)->landmark);
  const auto after = map.snapshot(2);
  EXPECT_TRUE(after->keyframes[2]->observations.empty());
  for (const auto& keyframe : after->keyframes)
    for (const Observation& o : keyframe->observations)
      EXPECT_NE(after->find(o.landmark), nullptr) << o.landmark.value;
  EXPECT_EQ(after->landmarks.size(), 101U);
  EXPECT_EQ(after->find(LandmarkId(0))->observations, 3);
}

TEST(Rest, ItGoesWhereItsHostGoes) {
  SeenAgain world;
  rest(world.map, 2, 0, 3);
  world.frames.push_back({FrameId(9), 5, 2, Pose(so3_exp({0, 0.1, 0}), {0.5, 0, 0})});
  const Pose T_host_this =
      world.map.keyframes[0].T_world_camera.inverse() * world.map.keyframes[2].T_world_camera;
  // An adjustment moves the host.
  world.map.keyframes[0].T_world_camera = {so3_exp({0.1, 0, 0.2}), {3, 1, 2}};
  follow_hosts(world.map);
  const auto offset = [&] {
    return (world.map.keyframes[0].T_world_camera.inverse() * world.map.keyframes[2].T_world_camera)
        .translation();
  };
  EXPECT_LT((offset() - T_host_this.translation()).norm(), 1e-12);
  // A loop moves the hosts, and makes the host's part of the map twice as large.
  std::vector<Sim3> moved;
  for (const MapKeyframe& k : world.map.keyframes)
    moved.push_back({1, k.T_world_camera.rotation(), k.T_world_camera.translation()});
  moved[0] = Sim3(2, moved[0].rotation(), moved[0].translation() + Eigen::Vector3d(1, 1, 1));
  move_keyframes(world.map, world.frames, moved);
  EXPECT_LT((offset() - 2 * T_host_this.translation()).norm(), 1e-12);
  EXPECT_NEAR(world.frames[0].T_keyframe_frame.translation().x(), 1, 1e-12);
  const Pose before = world.map.keyframes[2].T_world_camera;
  follow_hosts(world.map);
  EXPECT_LT((before.translation() - world.map.keyframes[2].T_world_camera.translation()).norm(),
            1e-12);
}

}  // namespace
}  // namespace corvid
