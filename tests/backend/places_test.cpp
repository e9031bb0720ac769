// Lost and found: relocalization, loops and segments that meet, with a perfect place finder.
#include "backend/places.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

#include "backend/backend.h"
#include "tests/backend/simulator.h"

namespace corvid {
namespace {

constexpr std::uint32_t kLater = 100'000;  // added to the ids of tracks after a break

/// Round an ellipse before a wall of points, back to the start.
std::function<Pose(double)> round_path() {
  return [](double s) {
    const double angle = 2 * std::numbers::pi * s;
    return Pose(test::wobble(s, 0.02), {9 * std::sin(angle), 4 * (1 - std::cos(angle)), 0});
  };
}

test::Simulation round_flight() {
  test::Simulation s;
  s.camera = test::pinhole_camera();
  s.path = round_path();
  s.frames = 200;
  s.keyframe_every = 4;
  return s;
}

std::size_t position_of(const test::Flight& flight, FrameId frame) {
  std::size_t i = 0;
  while (flight.frames[i].frame->id != frame) ++i;
  return i;
}

/// What a place finder would say: the landmarks of frame `reference`'s keyframe in frame `query`.
/// @param shift  of the places where they are found, as seen from a query that is moved by it: a
///               wall that repeats itself.
PlaceReference look_up(const Backend& backend, const test::Flight& flight, std::size_t query,
                       std::size_t reference, const Eigen::Vector3d& shift = {0, 0, 0}) {
  PlaceReference found;
  found.keyframe = flight.frames[reference].frame->id;
  const Camera& camera = *flight.frames[query].frame->camera;
  const Pose T = flight.truth[query];
  const Pose T_camera_world = Pose(T.rotation(), T.translation() + shift).inverse();
  const auto map = backend.map();
  for (const auto& keyframe : map->keyframes) {
    if (keyframe->frame->id != found.keyframe) continue;
    for (const Observation& o : keyframe->observations) {
      const TrackId id(o.landmark.value);
      const std::uint32_t point = o.landmark.value % kLater;
      if (std::binary_search(flight.wrong.begin(), flight.wrong.end(), TrackId(point))) continue;
      const Eigen::Vector3d p = T_camera_world * flight.points[point];
      const auto pixel = p.z() > 0 ? camera.project(p) : std::nullopt;
      if (!pixel || !camera.in_image(*pixel, 5)) continue;
      found.views.push_back({id, *pixel, 0.01 * Eigen::Matrix2d::Identity()});
    }
  }
  return found;
}

/// As if the frontend had lost all tracks before frame `from`.
void break_tracks(test::Flight& flight, std::size_t from) {
  for (std::size_t i = from; i < flight.frames.size(); ++i)
    for (TrackObservation& o : flight.frames[i].observations) o.track.value += kLater;
}

/// How far apart two frames of a trajectory are [share of the way].
double gap(const Trajectory& trajectory) {
  double way = 0;
  for (std::size_t i = 1; i < trajectory.size(); ++i)
    way += (trajectory[i].T_world_camera.translation() -
            trajectory[i - 1].T_world_camera.translation())
               .norm();
  return (trajectory.back().T_world_camera.translation() -
          trajectory.front().T_world_camera.translation())
             .norm() /
         way;
}

class Places : public testing::Test {
 protected:
  void start(const test::Simulation& simulation) {
    flight = test::Simulator(simulation).fly();
    BackendOptions options;
    options.final_adjustment = false;
    options.intrinsics = "fixed";
    backend = std::make_unique<Backend>(options, IntrinsicsOrigin::calibration, 1);
  }
  PoseEvent add(std::size_t i) { return event = backend->add(flight.frames[i]); }
  [[nodiscard]] std::size_t last_query() const {
    return position_of(flight, backend->place_query()->frame->id);
  }

  test::Flight flight;
  std::unique_ptr<Backend> backend;
  PoseEvent event;
};

TEST_F(Places, ALoopCloses) {
  test::Simulation s = round_flight();
  s.noise_px = 0.7;
  s.believed = s.camera;
  s.believed.cx_px += 6;  // drifts
  start(s);
  for (std::size_t i = 0; i + 4 < flight.frames.size(); ++i) add(i);
  ASSERT_EQ(event.state, TrackingState::tracking);
  ASSERT_EQ(event.segment, 0);
  EXPECT_EQ(event.resets, 0U);
  const auto query = last_query();
  const double before = gap(backend->trajectory());
  PlaceMatch match{flight.frames[query].frame->id, {look_up(*backend, flight, query, 8)}};
  ASSERT_GT(match.references[0].views.size(), 60U);
  backend->recognise(match);
  EXPECT_EQ(backend->places().loops, 1);
  EXPECT_EQ(backend->places().refused, 0);
  for (std::size_t i = flight.frames.size() - 4; i < flight.frames.size(); ++i) add(i);
  EXPECT_EQ(event.state, TrackingState::tracking);
  EXPECT_EQ(event.resets, 1U);
  const double after = gap(backend->trajectory());
  std::printf("gap %.4f %% of the way, was %.4f %%\n", 100 * after, 100 * before);
  EXPECT_LT(after, 0.3 * before);
  // Seen again, it is known, although the wrong calibration bends the map.
  backend->recognise(
      {flight.frames[last_query()].frame->id, {look_up(*backend, flight, last_query(), 8)}});
  EXPECT_EQ(backend->places().loops + backend->places().connections, 2);
}

/// Laps over the same ground, always recognised: what is new on them is not kept.
TEST_F(Places, LapsOverKnownGroundDoNotMakeTheMapGrow) {
  constexpr int kLaps = 5, kLap = 200;
  test::Simulation s = round_flight();
  s.path = [](double t) { return round_path()(kLaps * t); };
  s.frames = kLaps * kLap;
  start(s);
  std::vector<std::size_t> observations;
  for (int i = 0; i < s.frames; ++i) {
    add(static_cast<std::size_t>(i));
    ASSERT_TRUE(i < 60 || event.state == TrackingState::tracking) << i << ' ' << event.reason;
    const int seen_before = i % kLap / s.keyframe_every * s.keyframe_every;
    if (i > kLap && i % (3 * s.keyframe_every) == 0 && backend->place_query())
      backend->recognise(
          {flight.frames[last_query()].frame->id,
           {look_up(*backend, flight, last_query(), static_cast<std::size_t>(seen_before))}});
    if (i % kLap != kLap - 1) continue;
    observations.push_back(0);
    for (const auto& keyframe : backend->map()->keyframes)
      observations.back() += keyframe->observations.size();
    std::printf("%zu observations, %zu landmarks\n", observations.back(),
                backend->map()->landmarks.size());
  }
  EXPECT_GT(backend->places().connections, 20);
  // The newest keyframes of a lap are still at work.
  EXPECT_LT(static_cast<double>(observations.back()), 1.1 * static_cast<double>(observations[1]));
  const test::Ate ate = test::absolute_error(backend->trajectory(), flight);
  std::printf("ATE %.5f of %.1f\n", ate.rmse(), kLaps * 43.0);
  EXPECT_EQ(ate.poses, flight.frames.size());
  EXPECT_LT(ate.rmse(), 0.02);
}

TEST_F(Places, AWallThatRepeatsItselfIsNoLoop) {
  start(round_flight());
  for (std::size_t i = 0; i + 20 < flight.frames.size(); ++i) add(i);
  const auto query = last_query();
  const auto trajectory = backend->trajectory();
  // Every landmark agrees, on a pose that is wrong by a tenth of the way flown and more.
  PlaceMatch match{flight.frames[query].frame->id,
                   {look_up(*backend, flight, query, 8, {7, 0, 0})}};
  ASSERT_GT(match.references[0].views.size(), 40U);
  backend->recognise(match);
  // Two keyframes that are alike give two poses.
  match.references = {look_up(*backend, flight, query, 8, {0.5, 0, 0}),
                      look_up(*backend, flight, query, 4, {-0.5, 0, 0})};
  backend->recognise(match);
  // Few landmarks, in one corner.
  match.references = {look_up(*backend, flight, query, 8)};
  std::erase_if(match.references[0].views,
                [](const PlaceView& v) { return v.pixel.x() > 250 || v.pixel.y() > 200; });
  backend->recognise(match);
  EXPECT_EQ(backend->places().refused, 3);
  EXPECT_EQ(backend->places().loops + backend->places().connections, 0);
  const auto after = backend->trajectory();
  for (std::size_t i = 0; i < trajectory.size(); ++i)
    EXPECT_EQ(after[i].T_world_camera.translation(), trajectory[i].T_world_camera.translation());
}

TEST_F(Places, NonsenseIsRefused) {
  start(round_flight());
  backend->recognise({});
  backend->recognise({FrameId(3), {{FrameId(1), 0, 0, {}}}});  // there is no map
  for (std::size_t i = 0; i < 60; ++i) add(i);
  const auto query = last_query();
  PlaceReference nowhere = look_up(*backend, flight, query, 8);
  for (PlaceView& v : nowhere.views) v.pixel.setConstant(std::nan(""));
  backend->recognise({flight.frames[query].frame->id, {nowhere}});
  PlaceReference scrambled = look_up(*backend, flight, query, 8);
  std::mt19937_64 random(2);
  for (PlaceView& v : scrambled.views)
    v.pixel = {static_cast<double>(random() % 752), static_cast<double>(random() % 480)};
  backend->recognise({flight.frames[query].frame->id, {scrambled}});
  backend->recognise({FrameId(999), {look_up(*backend, flight, query, 8)}});  // no such frame
  backend->recognise({flight.frames[query].frame->id, {{FrameId(777), 1, 1, nowhere.views}}});
  EXPECT_EQ(backend->places().loops + backend->places().relocalizations, 0);
  EXPECT_EQ(add(60).state, TrackingState::tracking);
}

TEST_F(Places, ALostCameraIsFoundInItsMap) {
  start(round_flight());
  break_tracks(flight, 150);
  for (std::size_t i = 0; i < 100; ++i) add(i);
  ASSERT_EQ(event.segment, 0);
  add(160);  // kidnapped, back over what it saw
  EXPECT_FALSE(event.T_world_camera);
  EXPECT_EQ(event.segment, 1) << "a new segment would start";
  ASSERT_TRUE(backend->place_query());
  const auto query = last_query();
  EXPECT_EQ(query, 160U);
  std::size_t reference = 0;  // the mirrored half of the ellipse has the same place nowhere else
  double nearest = 1e9;
  for (const auto& k : backend->map()->keyframes) {
    const auto i = position_of(flight, k->frame->id);
    const double d = (flight.truth[i].translation() - flight.truth[query].translation()).norm();
    if (d < nearest) std::tie(nearest, reference) = std::pair(d, i);
  }
  PlaceMatch match{flight.frames[query].frame->id, {look_up(*backend, flight, query, reference)}};
  backend->recognise(match);
  ASSERT_EQ(backend->places().relocalizations, 1) << match.references[0].views.size();
  int tracked = 0;
  for (std::size_t i = 161; i < flight.frames.size(); ++i)
    tracked += add(i).T_world_camera.has_value() ? 1 : 0;
  EXPECT_GE(tracked, 37) << event.reason;
  EXPECT_EQ(event.segment, 0);
  EXPECT_GE(event.resets, 1U);
  const auto error = test::absolute_error(backend->trajectory(), flight);
  std::printf("error %.4f of a way of 44\n", error.rmse());
  EXPECT_LT(error.rmse(), 0.06);
}

TEST_F(Places, SegmentsThatMeetAreOne) {
  start(round_flight());
  break_tracks(flight, 110);
  for (std::size_t i = 0; i < flight.frames.size(); ++i)
    if (i < 100 || i >= 110) add(i);
  ASSERT_EQ(event.state, TrackingState::tracking);
  ASSERT_EQ(event.segment, 1);
  const auto query = last_query();
  ASSERT_GT(test::absolute_error(backend->trajectory(), flight).rmse(), 0.2)
      << "the two parts have each a scale";
  backend->recognise({flight.frames[query].frame->id, {look_up(*backend, flight, query, 4)}});
  EXPECT_EQ(backend->places().merges, 1);
  for (const auto& k : backend->map()->keyframes) EXPECT_EQ(k->segment, 0);
  const auto error = test::absolute_error(backend->trajectory(), flight);
  std::printf("error %.4f of a way of 44\n", error.rmse());
  EXPECT_LT(error.rmse(), 0.1);
}

}  // namespace
}  // namespace corvid
