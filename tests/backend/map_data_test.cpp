#include "backend/map_data.h"

#include <gtest/gtest.h>

#include <random>

#include "backend/map_edit.h"

namespace corvid {
namespace {

/// What a snapshot must hold, made from nothing.
std::vector<Landmark> all_landmarks(const MapData& map) {
  std::vector<Landmark> landmarks;
  for (const auto& [id, track] : map.tracks) {
    if (!track.landmark) continue;
    landmarks.push_back({LandmarkId(id.value), track.p_world, track.colour,
                         static_cast<int>(track.views.size()), track.max_ray_angle_rad});
  }
  return landmarks;
}

void expect_same(const Landmarks& got, const std::vector<Landmark>& wanted) {
  ASSERT_EQ(got.size(), wanted.size());
  auto it = got.begin();
  for (const Landmark& l : wanted) {
    ASSERT_EQ(it->id, l.id);
    ASSERT_EQ(it->p_world, l.p_world) << l.id.value;
    ASSERT_EQ(it->observations, l.observations) << l.id.value;
    EXPECT_EQ(it->max_ray_angle_rad, l.max_ray_angle_rad);
    ++it;
  }
}

class EditedMap : public ::testing::Test {
 protected:
  EditedMap() {
    map.camera.width_px = 640;
    map.camera.height_px = 480;
    map.camera.fx_px = map.camera.fy_px = 400;
    map.camera.cx_px = 320;
    map.camera.cy_px = 240;
  }

  /// A keyframe that follows most tracks of the one before and some new ones.
  void add_keyframe() {
    std::vector<TrackObservation> seen;
    const std::uint32_t first = next_ > 300 ? next_ - 300 : 0;
    next_ += 120;
    for (std::uint32_t id = first; id < next_; ++id) {
      TrackObservation o;
      o.track = TrackId(id);
      o.pixel = {pixel_(random_), 0.7 * pixel_(random_)};
      o.covariance_px2 = Eigen::Matrix2d::Identity();
      seen.push_back(o);
    }
    auto frame = std::make_shared<Frame>();
    frame->grey = GreyImage(640, 480);
    const Pose T(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.1 * next_, 0, 0));
    map.add_keyframe(frame, 0, T, seen);
  }

  MapTrack& any_track() {
    const auto it = map.tracks.lower_bound(TrackId(static_cast<std::uint32_t>(random_() % next_)));
    return (it == map.tracks.end() ? std::prev(it) : it)->second;
  }

  void make_point(MapTrack& track) {
    Triangulation point;
    point.status = TriangulationStatus::ok;
    point.p_world = Eigen::Vector3d(pixel_(random_), pixel_(random_), 1);
    point.max_ray_angle_rad = 0.1;
    if (!track.views.empty()) map.make_landmark(track, point);
  }

  MapData map;
  std::mt19937 random_{3};
  std::uniform_real_distribution<double> pixel_{1, 639};
  std::uint32_t next_ = 0;
};

TEST_F(EditedMap, SnapshotsShareOnlyWhatDidNotChange) {
  std::vector<std::shared_ptr<const MapSnapshot>> snapshots;
  std::vector<std::vector<Landmark>> wanted;
  std::vector<FrameRecord> frames;
  FusedTracks fused;
  for (std::uint64_t round = 0; round < 60; ++round) {
    add_keyframe();
    for (int i = 0; i < 150; ++i) make_point(any_track());
    for (int i = 0; i < 20; ++i) map.drop_landmark(any_track());
    for (int i = 0; i < 20; ++i)
      if (MapTrack& track = any_track(); track.views.size() > 1) map.drop_view(track, 0);
    for (int i = 0; i < 10; ++i)
      (void)fuse_tracks(map, TrackId(static_cast<std::uint32_t>(random_() % next_)),
                        TrackId(static_cast<std::uint32_t>(random_() % next_)), fused);
    if (round % 10 == 9) {
      std::vector<Sim3> moved;
      for (const MapKeyframe& k : map.keyframes)
        moved.emplace_back(1.1, k.T_world_camera.rotation(),
                           k.T_world_camera.translation() + Eigen::Vector3d(0, 1, 0));
      move_keyframes(map, frames, moved);
    }
    if (round % 5 == 3) map.forget_tracks(static_cast<int>(map.keyframes.size()) - 3);
    snapshots.push_back(map.snapshot(round));
    wanted.push_back(all_landmarks(map));
    expect_same(snapshots.back()->landmarks, wanted.back());
  }
  for (std::size_t i = 0; i < snapshots.size(); ++i)
    expect_same(snapshots[i]->landmarks, wanted[i]);  // older ones stay as they were
  EXPECT_GT(wanted.back().size(), 1000U);
  EXPECT_GT(fused.size(), 10U);
  // A snapshot of a map that did not change is that of before.
  const auto again = map.snapshot(99);
  EXPECT_EQ(&*again->landmarks.begin(), &*snapshots.back()->landmarks.begin());
}

}  // namespace
}  // namespace corvid
