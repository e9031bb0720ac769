// Edits of maps made by hand.
#include "backend/map_edit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "backend/map_positions.h"
#include "backend/places.h"
#include "backend/simulator.h"
#include "core/geodesy.h"

namespace corvid {
namespace {

/// A camera that is not turned.
Pose at(double x, double y = 0, double z = 0) {
  return {Eigen::Quaterniond::Identity(), Eigen::Vector3d(x, y, z)};
}

/// Keyframes that see landmarks where these are, exactly.
struct HandMade {
  MapData map;
  std::vector<FrameRecord> frames;
  FusedTracks fused;
  HandMade() { map.camera = test::pinhole_camera(); }

  int add(int segment, const Pose& T_world_camera, std::int64_t time_ns = 0) {
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(map.keyframes.size()));
    frame->time_ns = time_ns;
    return map.add_keyframe(frame, segment, T_world_camera, {});
  }
  void landmark(std::uint32_t id, const Eigen::Vector3d& p_world, const std::vector<int>& seen_in) {
    MapTrack& track = map.tracks[TrackId(id)];
    track.landmark = true;
    track.p_world = p_world;
    for (const int k : seen_in) add_view(map, k, {TrackId(id), pixel(k, p_world)});
    ASSERT_EQ(track.views.size(), seen_in.size());
  }
  [[nodiscard]] Eigen::Vector2d pixel(int k, const Eigen::Vector3d& p_world) const {
    return map.camera
        .project(map.keyframes[static_cast<std::size_t>(k)].T_world_camera.inverse() * p_world)
        .value();
  }
};

/// Points before a camera, 4 to 7 units away.
std::vector<Eigen::Vector3d> points_before(const Pose& T_world_camera) {
  std::vector<Eigen::Vector3d> points;
  for (int y = -2; y <= 2; ++y)
    for (int x = -3; x <= 3; ++x)
      points.emplace_back(T_world_camera * Eigen::Vector3d(0.8 * x, 0.7 * y, 5.5 + 0.5 * x));
  return points;
}

/// What place_pose() says of a query that is at T_world_query in the map of `reference`.
PlacePose found(const HandMade& hand, int reference, const Pose& T_world_query) {
  PlacePose place;
  place.ok = true;
  place.reference = reference;
  place.segment = hand.map.keyframes[static_cast<std::size_t>(reference)].segment;
  place.T_world_query = T_world_query;
  for (const TrackId id : hand.map.keyframes[static_cast<std::size_t>(reference)].tracks) {
    const Eigen::Vector3d p = T_world_query.inverse() * hand.map.tracks.at(id).p_world;
    const auto pixel = hand.map.camera.project(p);
    if (pixel && hand.map.camera.in_image(*pixel)) place.inliers.push_back({id, {id, *pixel}});
  }
  return place;
}

/// Segment 0 with one keyframe, and segment 1 with another, 2 of its units for one of segment 0,
/// that sees the same landmarks.
struct TwoSegments : HandMade {
  const Pose T_0_a{so3_exp({0.02, -0.1, 0.05}), {1, 2, 3}};
  const Pose T_0_b = T_0_a * Pose(so3_exp({0, 0.1, 0}), {1.5, 0.2, 0});
  const Sim3 S_1_0{2, so3_exp({0.3, 0.2, -1}), {-4, 5, 6}};
  int a = 0, b = 0;
  TwoSegments() {
    a = add(0, T_0_a);
    b = add(1, S_1_0 * T_0_b);
    std::uint32_t id = 0;
    for (const Eigen::Vector3d& p : points_before(T_0_a * at(0.7))) {
      landmark(id, p, {a});
      landmark(1000 + id, S_1_0 * p, {b});
      ++id;
    }
    Vector7d sigma;
    sigma << 0.01, 0.02, 0.01, 0.004, 0.003, 0.005, 0.02;
    Drift& drift = map.keyframes[0].drift;
    drift.known = true;
    drift.covariance = sigma.cwiseAbs2().asDiagonal();
    drift.by_focal << 0.3, 0.1, -0.2, 0.01, 0, 0.02, 0.1;
  }
};

TEST(MapEdit, AMergeInheritsTheSameDriftWhicheverSideIsRecognised) {
  TwoSegments newer, older;
  const PlacePose b_in_0 = found(newer, newer.a, newer.T_0_b);
  const PlacePose a_in_1 = found(older, older.b, older.S_1_0 * older.T_0_a);
  ASSERT_EQ(recognise_keyframe(newer.map, newer.frames, newer.fused, newer.b, b_in_0, {}, 1).kind,
            PlaceOutcome::Kind::merge);
  ASSERT_EQ(recognise_keyframe(older.map, older.frames, older.fused, older.a, a_in_1, {}, 1).kind,
            PlaceOutcome::Kind::merge);
  for (TwoSegments* const merged : {&newer, &older}) {
    ASSERT_EQ(merged->map.keyframes[1].segment, 0);
    const Pose& T = merged->map.keyframes[1].T_world_camera;
    ASSERT_LT((merged->T_0_b.inverse() * T).log().norm(), 1e-9);
    // A turn at the one is a shift at the other.
    const Drift expected = merged->map.keyframes[0].drift.seen_from(merged->T_0_a.inverse() * T);
    const Drift& drift = merged->map.keyframes[1].drift;
    EXPECT_LT((drift.covariance - expected.covariance).norm(), 1e-9 * expected.covariance.norm());
    EXPECT_LT((drift.by_focal - expected.by_focal).norm(), 1e-9);
  }
}

TEST(MapEdit, ThePlacesOwnCovarianceIsInTheUnitsOfTheMapThatStays) {
  TwoSegments older;
  for (MapKeyframe& k : older.map.keyframes) k.drift = Drift{};
  PlacePose a_in_1 = found(older, older.b, older.S_1_0 * older.T_0_a);
  a_in_1.covariance.topLeftCorner<3, 3>() = 0.04 * Eigen::Matrix3d::Identity();
  ASSERT_EQ(recognise_keyframe(older.map, older.frames, older.fused, older.a, a_in_1, {}, 1).kind,
            PlaceOutcome::Kind::merge);
  // 0.2 units of segment 1 are 0.1 of segment 0.
  const Matrix6d P = older.map.keyframes[1].drift.covariance.topLeftCorner<6, 6>();
  const double trace = P.diagonal().head<3>().sum();
  EXPECT_NEAR(trace, 3 * kObservationsPerFact * 0.01, 1e-9);
}

TEST(MapEdit, ALeapWhileTheCameraWasLostIsNoWayFlown) {
  for (const bool followed : {false, true}) {
    HandMade hand;
    std::uint32_t id = 0;
    std::vector<int> keyframes;
    for (const double x : {0.0, 1.0, 2.0, 102.0, 103.0}) {
      keyframes.push_back(hand.add(0, at(x)));
      for (const Eigen::Vector3d& p : points_before(at(x)))
        hand.landmark(id++, p, {keyframes.back()});
    }
    // Each sees a little of the one before, but for the leap.
    for (std::size_t i = 1; i < keyframes.size(); ++i) {
      if (i == 3 && !followed) continue;
      const TrackId shared(id++);
      hand.map.tracks[shared];
      for (const std::size_t k : {i - 1, i}) add_view(hand.map, keyframes[k], {shared, {300, 200}});
    }
    // The last looks like the first, 2 units from where it should be: too much after 3 flown.
    const int query = keyframes.back();
    PlacePose place = found(hand, keyframes.front(), Pose());
    place.T_world_query = at(101);
    for (const TrackId old : hand.map.keyframes[0].tracks)
      if (auto& track = hand.map.tracks.at(old); track.landmark)
        track.p_world += Eigen::Vector3d(101, 0, 0);
    const PlaceOutcome outcome =
        recognise_keyframe(hand.map, hand.frames, hand.fused, query, place, {}, 1);
    if (followed) {
      EXPECT_NE(outcome.kind, PlaceOutcome::Kind::refused) << outcome.reason;
    } else {
      EXPECT_EQ(outcome.kind, PlaceOutcome::Kind::refused);
      EXPECT_NE(outcome.reason.find("after a way of 3"), std::string::npos) << outcome.reason;
    }
  }
}

TEST(MapEdit, AStraightenedMapCarriesFusedLandmarksWithTheMiddleOfTheirViews) {
  // A map whose scale falls by a fifth on the way, with exact positions.
  HandMade hand;
  BackendOptions options;
  MapPositions positions(options);
  std::vector<PositionFix> fixes;
  const GeodeticPosition origin{0.8, 0.1, 400};
  Eigen::Vector3d p = Eigen::Vector3d::Zero(), truth = p;
  constexpr int kCount = 300, kMiddle = kCount - 6;
  for (int i = 0; i < kCount; ++i) {
    const std::int64_t time_ns = 100'000'000LL * i;
    hand.add(0, at(p.x(), p.y(), p.z()), time_ns);
    hand.frames.push_back({FrameId(static_cast<std::uint32_t>(i)), time_ns, i, Pose()});
    PositionFix fix;
    fix.time_ns = time_ns;
    fix.position = to_geodetic(LocalFrame(origin).to_ecef(truth));
    fix.covariance_m2 = 0.01 * Eigen::Matrix3d::Identity();
    fixes.push_back(fix);
    const Eigen::Vector3d step(1, std::sin(0.1 * i), 0.5 * std::cos(0.07 * i));
    truth += step;
    p += step * (1 - 0.2 * i / kCount);
  }
  positions.add(fixes);
  // Seen at the start, and then in the last ten.
  const Pose& T_last = hand.map.keyframes.back().T_world_camera;
  const Eigen::Vector3d seen = T_last * Eigen::Vector3d(0, 0, 40);
  MapTrack& fused = hand.map.tracks[TrackId(7)];
  fused.landmark = true;
  fused.p_world = seen;
  for (int k = 0; k < kCount; k = k == 0 ? kCount - 10 : k + 1)
    fused.views.push_back({k, {300, 200}, Eigen::Vector3d::UnitZ(), 1});
  positions.follow(hand.map, 0);
  ASSERT_EQ(positions.placement(0)->scale, MapScale::metric) << positions.placement(0)->reason;
  const Pose T_middle = hand.map.keyframes[kMiddle].T_world_camera;
  const Eigen::Vector3d in_middle = T_middle.inverse() * seen;
  const auto straight = positions.straightened(hand.map, 0);
  ASSERT_GT(straight.back().scale() / straight.front().scale(), 1.1);
  move_keyframes(hand.map, hand.frames, straight);
  EXPECT_TRUE(positions.place_whole(hand.map, 0));
  const Eigen::Vector3d now = hand.map.keyframes[kMiddle].T_world_camera.inverse() * fused.p_world;
  EXPECT_LT((now / straight[kMiddle].scale() - in_middle).norm(), 1e-6 * in_middle.norm());
}

TEST(MapEdit, AFusedLandmarkHasItsNewNameInEveryKeyframeOfTheSnapshot) {
  HandMade hand;
  for (int i = 0; i < 6; ++i) hand.add(0, at(0.3 * i));
  const auto points = points_before(at(0));
  for (std::uint32_t i = 0; i < points.size(); ++i) hand.landmark(10 * i, points[i], {0, 1, 2});
  (void)hand.map.snapshot(1);
  // Seen again in new keyframes, under names in another chunk; one was seen in keyframe 2, too.
  for (const std::uint32_t i : {3U, 5U, 7U}) {
    hand.landmark(5000 + i, points[i], i == 5 ? std::vector<int>{2, 4, 5} : std::vector<int>{4, 5});
    ASSERT_TRUE(fuse_tracks(hand.map, TrackId(5000 + i), TrackId(10 * i), hand.fused));
  }
  // And one of them once more before the next snapshot.
  hand.landmark(9000, points[3], {5});
  ASSERT_TRUE(fuse_tracks(hand.map, TrackId(9000), TrackId(5003), hand.fused));
  const auto now = hand.map.snapshot(2);
  MapData fresh = hand.map;
  for (MapKeyframe& keyframe : fresh.keyframes) keyframe.published = nullptr;
  fresh.published_landmarks.clear();
  for (const auto& [id, track] : fresh.tracks) fresh.stale_landmarks.insert(chunk_of(id));
  const auto wanted = fresh.snapshot(2);
  ASSERT_EQ(now->landmarks.size(), wanted->landmarks.size());
  for (const Landmark& landmark : wanted->landmarks) {
    const Landmark* const found = now->find(landmark.id);
    ASSERT_NE(found, nullptr) << landmark.id.value;
    EXPECT_EQ(found->observations, landmark.observations);
  }
  for (std::size_t k = 0; k < wanted->keyframes.size(); ++k) {
    const auto& a = now->keyframes[k]->observations;
    const auto& b = wanted->keyframes[k]->observations;
    ASSERT_EQ(a.size(), b.size()) << k;
    for (std::size_t i = 0; i < a.size(); ++i) {
      EXPECT_EQ(a[i].landmark, b[i].landmark);
      EXPECT_EQ(a[i].pixel, b[i].pixel);
    }
  }
}

TEST(MapEdit, ASnapshotFollowsWhatMovedAndSharesWhatDidNot) {
  TwoSegments two;
  const int beside = two.add(0, two.T_0_a * at(0.1));
  const auto before = two.map.snapshot(1);
  std::vector<Sim3> T_world_keyframe;
  for (const MapKeyframe& k : two.map.keyframes)
    T_world_keyframe.emplace_back(1, k.T_world_camera.rotation(), k.T_world_camera.translation());
  T_world_keyframe[0] = T_world_keyframe[0] * Sim3(1.1, so3_exp({0, 0.1, 0}), {0.2, 0, 0});
  move_keyframes(two.map, two.frames, T_world_keyframe);
  join_segments(two.map, two.frames, 1, 0, Sim3(), two.b, {});  // which moves nothing
  const auto now = two.map.snapshot(2);
  MapData fresh = two.map;
  for (MapKeyframe& keyframe : fresh.keyframes) keyframe.published = nullptr;
  const auto wanted = fresh.snapshot(2);
  for (std::size_t k = 0; k < 3; ++k) {
    const Keyframe &a = *now->keyframes[k], &b = *wanted->keyframes[k];
    EXPECT_EQ(a.segment, 0);
    EXPECT_EQ(a.T_world_camera.translation(), b.T_world_camera.translation());
    EXPECT_EQ(a.T_world_camera.rotation().coeffs(), b.T_world_camera.rotation().coeffs());
    ASSERT_EQ(a.observations.size(), b.observations.size());
    for (std::size_t i = 0; i < a.observations.size(); ++i)
      EXPECT_EQ(a.observations[i].landmark, b.observations[i].landmark);
  }
  EXPECT_EQ(now->keyframes[static_cast<std::size_t>(beside)],
            before->keyframes[static_cast<std::size_t>(beside)]);
  ASSERT_EQ(now->landmarks.size(), wanted->landmarks.size());
  for (const Landmark& landmark : wanted->landmarks)
    EXPECT_EQ(now->find(landmark.id)->p_world, landmark.p_world);
  EXPECT_NE(now->find(LandmarkId(0))->p_world, before->find(LandmarkId(0))->p_world);
  EXPECT_EQ(now->find(LandmarkId(1000))->p_world, before->find(LandmarkId(1000))->p_world);
}

TEST(MapEdit, TracksBesideAFusedLandmarkBorrowItsDepth) {
  HandMade hand;
  const int a = hand.add(0, at(0)), query = hand.add(0, at(0.2));
  const Eigen::Vector3d p(0.1, 0.2, 5);
  hand.landmark(1, p, {a});
  hand.map.tracks[TrackId(2)];  // the query's own track of the same feature
  add_view(hand.map, query, {TrackId(2), hand.pixel(query, p)});
  hand.map.tracks[TrackId(3)];  // and one beside it
  add_view(hand.map, query, {TrackId(3), hand.pixel(query, p) + Eigen::Vector2d(5, 0)});
  const std::vector<TrackObservation> observations{
      {TrackId(2), hand.pixel(query, p)},
      {TrackId(3), hand.pixel(query, p) + Eigen::Vector2d(5, 0)}};
  const PlacePose place = found(hand, a, at(0.2));
  ASSERT_EQ(place.inliers.size(), 1U);
  ASSERT_EQ(connect_place(hand.map, query, place, observations, hand.fused), 1);
  EXPECT_EQ(guess_points(hand.map, query, place, observations, hand.fused), 1);
  EXPECT_TRUE(hand.map.tracks.at(TrackId(3)).landmark);
  EXPECT_NEAR(hand.map.tracks.at(TrackId(3)).p_world.z(), 5, 0.1);
}

}  // namespace
}  // namespace corvid
