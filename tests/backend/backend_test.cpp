#include "backend/backend.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cstring>
#include <iostream>

#include "backend/simulator.h"

namespace corvid {
namespace {

using test::Flight;
using test::Scene;
using test::Simulation;

Simulation sideways() {
  Simulation s;
  s.camera = test::radtan_camera();
  s.path = test::sideways_path(12);
  return s;
}

struct Outcome {
  std::vector<PoseEvent> events;
  Trajectory trajectory;
  std::shared_ptr<const MapSnapshot> map;
  std::vector<TrackId> rejected;  // ascending
  test::Ate ate;
  [[nodiscard]] std::size_t first_tracked() const {
    std::size_t i = 0;
    while (i < events.size() && !events[i].T_world_camera) ++i;
    return i;
  }
  [[nodiscard]] std::size_t untracked_after_start() const {
    std::size_t n = 0;
    for (std::size_t i = first_tracked(); i < events.size(); ++i) {
      n += events[i].T_world_camera ? 0U : 1U;
    }
    return n;
  }
};

Outcome run_backend(const Flight& flight, IntrinsicsOrigin origin = IntrinsicsOrigin::calibration,
                    int threads = 1, const BackendOptions& options = {}) {
  Backend backend(options, origin, threads);
  Outcome r;
  for (const FrameTracks& tracks : flight.frames) {
    r.events.push_back(backend.add(tracks));
    const PoseEvent& e = r.events.back();
    EXPECT_EQ(e.T_world_camera.has_value(),
              e.state == TrackingState::tracking || e.state == TrackingState::degraded);
    EXPECT_EQ(e.reason.empty(), e.state == TrackingState::tracking) << e.reason;
    if (e.T_world_camera) {
      EXPECT_TRUE(e.T_world_camera->finite());
      EXPECT_TRUE(e.covariance.allFinite());
    }
    const auto& rejected = backend.motion()->rejected;
    r.rejected.insert(r.rejected.end(), rejected.begin(), rejected.end());
  }
  backend.finish();
  std::sort(r.rejected.begin(), r.rejected.end());
  r.rejected.erase(std::unique(r.rejected.begin(), r.rejected.end()), r.rejected.end());
  r.trajectory = backend.trajectory();
  r.map = backend.map();
  r.ate = test::absolute_error(r.trajectory, flight);
  ::testing::Test::RecordProperty("ate", std::to_string(r.ate.rmse()));
  std::cout << "  first tracked " << r.first_tracked() << ", untracked after "
            << r.untracked_after_start() << ", poses " << r.trajectory.size() << " of "
            << flight.frames.size() << ", ATE " << r.ate.rmse() << ", landmarks "
            << r.map->landmarks.size() << ", rejected " << r.rejected.size() << " of "
            << flight.wrong.size() << " wrong\n";
  return r;
}

TEST(Backend, SidewaysFlightIsTrackedFromItsFirstFrame) {
  const Flight flight = test::Simulator(sideways()).fly();
  const Outcome r = run_backend(flight);
  EXPECT_LE(r.first_tracked(), 20U);
  EXPECT_EQ(r.untracked_after_start(), 0U);
  EXPECT_EQ(r.trajectory.size(), flight.frames.size());  // frames before the start included
  ASSERT_TRUE(r.ate.alignment.ok());
  EXPECT_LT(r.ate.rmse(), 0.01);
}

TEST(Backend, PositionsAreTimedOnlyWhereThereAreAny) {
  const Flight flight = test::Simulator(sideways()).fly();
  for (const bool any : {false, true}) {
    Backend backend({}, IntrinsicsOrigin::calibration, 1);
    PositionFix fix;
    fix.time_ns = flight.frames[3].frame->time_ns;
    fix.covariance_m2 = Eigen::Matrix3d::Identity();
    if (any) backend.add_positions(std::span(&fix, 1));
    int adjusted = 0, positioned = 0;
    for (const FrameTracks& tracks : flight.frames) {
      (void)backend.add(tracks);
      for (const auto& [part, ms] : backend.last_timings_ms()) {
        adjusted += part == "backend/adjust" ? 1 : 0;
        positioned += part == "backend/positions" ? 1 : 0;
      }
    }
    EXPECT_GT(adjusted, 5);
    EXPECT_EQ(positioned, any ? adjusted : 0);
    EXPECT_EQ(backend.trajectory_segments(), std::vector<int>(flight.frames.size(), 0));
  }
}

TEST(Backend, AStoppedAdjustmentAtTheEndLeavesAWholeMap) {
  const Flight flight = test::Simulator(sideways()).fly();
  for (const bool asked : {false, true}) {
    Backend backend({}, IntrinsicsOrigin::calibration, 1);
    for (const FrameTracks& tracks : flight.frames) (void)backend.add(tracks);
    const Trajectory in_flight = backend.trajectory();
    std::stop_source stop;
    if (asked) stop.request_stop();
    EXPECT_EQ(backend.finish(stop.get_token()), !asked);
    const Trajectory end = backend.trajectory();
    ASSERT_EQ(end.size(), in_flight.size());
    double moved = 0;
    for (std::size_t i = 0; i < end.size(); ++i)
      moved = std::max(
          moved, (end[i].T_world_camera.inverse() * in_flight[i].T_world_camera).log().norm());
    EXPECT_EQ(moved < 1e-12, asked) << moved;
    EXPECT_LT(test::absolute_error(end, flight).rmse(), 0.02);
  }
}

TEST(Backend, ForwardFlightWithTheEpipoleInTheImage) {
  Simulation s = sideways();
  s.scene = Scene::corridor;
  s.path = test::forward_path(30);
  s.frames = 200;
  const Flight flight = test::Simulator(s).fly();
  const Outcome r = run_backend(flight);
  EXPECT_LE(r.first_tracked(), 20U);
  EXPECT_EQ(r.untracked_after_start(), 0U);
  EXPECT_LT(r.ate.rmse(), 0.02);
}

TEST(Backend, PlaneStartsAndIsFollowed) {
  for (const Scene scene : {Scene::plane, Scene::tilted_plane}) {
    Simulation s = sideways();
    s.scene = scene;
    const Flight flight = test::Simulator(s).fly();
    const Outcome r = run_backend(flight);
    EXPECT_LE(r.first_tracked(), 40U);
    EXPECT_EQ(r.untracked_after_start(), 0U);
    EXPECT_LT(r.ate.rmse(), 0.03);
  }
}

TEST(Backend, TurningInPlaceNeverStarts) {
  Simulation s = sideways();
  s.path = test::turning_path(1.5);
  for (const double outliers : {0.0, 0.1}) {
    s.outliers = outliers;
    const Outcome r = run_backend(test::Simulator(s).fly());
    EXPECT_EQ(r.first_tracked(), r.events.size());
    EXPECT_TRUE(r.trajectory.empty());
    EXPECT_TRUE(r.map->landmarks.empty());
    EXPECT_FALSE(r.events.back().reason.empty());
  }
}

TEST(Backend, StandingStillNeverStartsButMovingAfterwardsDoes) {
  Simulation s = sideways();
  s.path = test::turning_path(0);
  const Outcome still = run_backend(test::Simulator(s).fly());
  EXPECT_EQ(still.first_tracked(), still.events.size());

  s.path = [move = test::sideways_path(8)](double t) { return move(std::max(0.0, 2 * t - 1)); };
  s.frames = 200;
  const Flight flight = test::Simulator(s).fly();
  const Outcome r = run_backend(flight);
  EXPECT_GT(r.first_tracked(), 100U);
  EXPECT_LT(r.first_tracked(), 125U);
  EXPECT_EQ(r.untracked_after_start(), 0U);
  EXPECT_LT(r.ate.rmse(), 0.02);
}

TEST(Backend, WrongTracksAreRejectedAndThirtyPercentSurvived) {
  Simulation s = sideways();
  s.outliers = 0.3;
  const Flight flight = test::Simulator(s).fly();
  const Outcome r = run_backend(flight);
  EXPECT_EQ(r.untracked_after_start(), 0U);
  EXPECT_LT(r.ate.rmse(), 0.02);
  std::vector<TrackId> good_rejected;
  std::set_difference(r.rejected.begin(), r.rejected.end(), flight.wrong.begin(),
                      flight.wrong.end(), std::back_inserter(good_rejected));
  EXPECT_LT(good_rejected.size(), 20U);
  // What became a landmark lies where the track's point is.
  const Sim3& T = r.ate.alignment.T_target_source;
  std::size_t wrong = 0, far = 0;
  for (const Landmark& l : r.map->landmarks) {
    const TrackId id(l.id.value);
    if (std::binary_search(flight.wrong.begin(), flight.wrong.end(), id)) {
      ++wrong;
      continue;
    }
    const double error = (T * l.p_world - flight.points[l.id.value]).norm();
    far += error > 1.0 ? 1U : 0U;
  }
  EXPECT_LT(wrong, r.map->landmarks.size() / 20);
  EXPECT_LT(far, r.map->landmarks.size() / 20);
}

TEST(Backend, StartsAreNeverWrong) {
  const auto forward = test::forward_path(60), sideways_far = test::sideways_path(40);
  for (const Scene scene : {Scene::corridor, Scene::box, Scene::plane, Scene::tilted_plane}) {
    for (std::uint64_t seed = 1; seed <= 8; ++seed) {
      Simulation s = sideways();
      s.scene = scene;
      s.path = [&](double t) {
        return (scene == Scene::corridor ? forward : sideways_far)(t / 10);
      };
      s.frames = 30;
      s.tracks = 300;
      s.seed = seed;
      s.outliers = 0.05 * static_cast<double>(seed % 4);
      s.noise_px = seed % 2 == 0 ? 0.5 : 0.3;
      const Flight flight = test::Simulator(s).fly();
      const Outcome r = run_backend(flight);
      ASSERT_LT(r.first_tracked(), flight.frames.size()) << "seed " << seed;
      ASSERT_EQ(r.trajectory.size(), flight.frames.size());
      const Pose estimate =
          r.trajectory.front().T_world_camera.inverse() * r.trajectory.back().T_world_camera;
      const Pose truth = flight.truth.front().inverse() * flight.truth.back();
      EXPECT_LT(so3_log(estimate.rotation().conjugate() * truth.rotation()).norm(), 0.01);
      EXPECT_LT((estimate.translation().normalized() - truth.translation().normalized()).norm(),
                0.05);
    }
  }
}

TEST(Backend, WideLenses) {
  for (const Camera& camera : {test::equidistant_camera(), test::fov_camera()}) {
    Simulation s = sideways();
    s.camera = camera;
    const Flight flight = test::Simulator(s).fly();
    const Outcome r = run_backend(flight);
    EXPECT_EQ(r.untracked_after_start(), 0U);
    EXPECT_LT(r.ate.rmse(), 0.02);
  }
}

TEST(Backend, StillsFarApartMakeOneMap) {
  Simulation s = sideways();
  s.scene = Scene::plane;
  s.camera = test::pinhole_camera();
  s.path = test::sideways_path(60);
  s.frames = 45;
  s.rate_hz = 0.5;
  s.keyframe_every = 1;
  s.death = 0.15;
  s.tracks = 300;
  const Flight flight = test::Simulator(s).fly();
  const Outcome r = run_backend(flight);
  EXPECT_EQ(r.trajectory.size(), 45U);
  EXPECT_EQ(r.map->keyframes.size(), 45U);
  EXPECT_EQ(r.events.back().segment, 0);
  EXPECT_LT(r.ate.rmse(), 0.05);
}

TEST(Backend, WrongIntrinsicsConvergeTowardsTheTruth) {
  Simulation s = sideways();
  s.camera = test::pinhole_camera();
  s.believed = s.camera;
  s.believed.fx_px *= 1.03;
  s.believed.fy_px *= 1.03;
  s.path = [](double t) {  // an arc round the scene: focal length is observable
    const double a = 0.8 * (t - 0.5);
    return Pose(so3_exp({0.05 * std::sin(9 * t), -a, 0.1 * std::sin(7 * t)}),
                Eigen::Vector3d(9 * std::sin(a), 0.8 * std::sin(9 * t), 9 - 9 * std::cos(a)));
  };
  const Flight flight = test::Simulator(s).fly();
  BackendOptions options;
  options.intrinsics = "fixed";
  const Outcome fixed = run_backend(flight, IntrinsicsOrigin::nominal, 1, options);
  const Outcome refined = run_backend(flight, IntrinsicsOrigin::nominal);
  const double f = refined.map->camera->fx_px;
  std::cout << "  focal length " << f << " of " << s.camera.fx_px << ", k "
            << refined.map->camera->distortion[0] << " " << refined.map->camera->distortion[1]
            << "\n";
  EXPECT_NEAR(f / s.camera.fx_px, 1.0, 0.005);
  EXPECT_NEAR(refined.map->camera->fy_px / f, s.camera.fy_px / s.camera.fx_px, 1e-9);
  EXPECT_LT(refined.ate.rmse(), 0.6 * fixed.ate.rmse());
}

TEST(Backend, WhatRectificationLeftOfTheDistortionIsFound) {
  Simulation s = sideways();
  s.camera = test::radtan_camera();
  s.camera.distortion = {0.025, -0.008, 0, 0, 0};
  s.believed = s.camera;
  s.believed.model = CameraModel::pinhole;  // "rectified"
  s.believed.distortion = {};
  const Flight flight = test::Simulator(s).fly();
  const Outcome refined = run_backend(flight);
  BackendOptions options;
  options.intrinsics = "fixed";
  const Outcome fixed = run_backend(flight, IntrinsicsOrigin::calibration, 1, options);
  const Camera& found = *refined.map->camera;
  std::cout << "  k " << found.distortion[0] << " " << found.distortion[1] << "\n";
  EXPECT_NEAR(found.distortion[0], 0.025, 0.005);
  EXPECT_EQ(found.fx_px, s.camera.fx_px);  // calibrated
  EXPECT_EQ(fixed.map->camera->model, CameraModel::pinhole);
  EXPECT_LT(refined.ate.rmse(), 0.5 * fixed.ate.rmse());
}

TEST(Backend, ACalibratedDistortionIsLeftAlone) {
  Simulation s = sideways();
  s.camera = test::radtan_camera();
  const Outcome r = run_backend(test::Simulator(s).fly());
  EXPECT_EQ(r.map->camera->distortion, s.camera.distortion);
}

TEST(Backend, FlatRaysLeaveTheIntrinsicsAlone) {
  Simulation s = sideways();
  s.camera = test::pinhole_camera();
  s.believed = s.camera;
  s.believed.fx_px *= 1.03;
  s.believed.fy_px *= 1.03;
  // Far enough to start, not twice as far, which is where intrinsics begin to be refined.
  s.path = [](double t) { return Pose(test::wobble(t, 0.05), {2 * t, 0, 0}); };
  BackendOptions options;
  options.start_min_parallax_rad = 0.05;
  const Outcome r = run_backend(test::Simulator(s).fly(), IntrinsicsOrigin::nominal, 1, options);
  ASSERT_GE(r.map->keyframes.size(), 6U);
  EXPECT_EQ(r.map->camera->fx_px, s.believed.fx_px);
  EXPECT_EQ(r.map->camera->distortion, s.believed.distortion);
}

/// Replaces the tracks of frames [from, to) by nothing, or by noise.
void cover_lens(Flight* flight, std::size_t from, std::size_t to) {
  for (std::size_t i = from; i < to; ++i) flight->frames[i].observations.clear();
}

TEST(Backend, AFewFramesWithoutAgreementAreSurvived) {
  Flight flight = test::Simulator(sideways()).fly();
  for (std::size_t i = 60; i < 68; ++i) {
    for (TrackObservation& o : flight.frames[i].observations) {
      o.pixel = {std::fmod(o.pixel.x() * 7919.0 + 13, 752.0),
                 std::fmod(o.pixel.y() * 104729.0, 480.0)};
    }
  }
  const Outcome r = run_backend(flight);
  for (std::size_t i = 60; i < 68; ++i) EXPECT_EQ(r.events[i].state, TrackingState::lost);
  for (std::size_t i = 70; i < r.events.size(); ++i) {
    EXPECT_TRUE(r.events[i].T_world_camera) << i << " " << r.events[i].reason;
    EXPECT_EQ(r.events[i].segment, 0);
  }
  EXPECT_LT(r.ate.rmse(), 0.02);
}

TEST(Backend, ALostCameraStartsANewSegment) {
  Simulation s = sideways();
  s.frames = 200;
  s.path = test::sideways_path(20);
  Flight flight = test::Simulator(s).fly();
  cover_lens(&flight, 90, 95);
  for (std::size_t i = 95; i < flight.frames.size(); ++i) {  // every track is a new one
    for (TrackObservation& o : flight.frames[i].observations) {
      o.track = TrackId(o.track.value + 100000);
    }
  }
  const Outcome r = run_backend(flight);
  EXPECT_EQ(r.events[89].segment, 0);
  EXPECT_EQ(r.events[92].state, TrackingState::lost);  // dark: nothing is given up yet
  EXPECT_EQ(r.events[92].segment, 0);
  EXPECT_EQ(r.events.back().segment, 1);
  EXPECT_EQ(r.events.back().state, TrackingState::tracking);
  EXPECT_EQ(r.map->keyframes.front()->segment, 0);
  EXPECT_EQ(r.map->keyframes.back()->segment, 1);
  for (const auto& keyframe : r.map->keyframes) {
    for (const Observation& o : keyframe->observations) ASSERT_NE(r.map->find(o.landmark), nullptr);
  }
  // Both parts are right, each in its own frame.
  Trajectory first, second;
  for (const StampedPose& p : r.trajectory) {
    (p.time_ns < flight.frames[92].frame->time_ns ? first : second).push_back(p);
  }
  EXPECT_LT(test::absolute_error(first, flight).rmse(), 0.02);
  EXPECT_LT(test::absolute_error(second, flight).rmse(), 0.02);
  EXPECT_GT(second.size(), 95U);
}

TEST(Backend, RepeatsBitForBit) {
  Simulation s = sideways();
  s.outliers = 0.2;
  const Flight flight = test::Simulator(s).fly();
  const Outcome a = run_backend(flight), b = run_backend(flight);
  ASSERT_EQ(a.trajectory.size(), b.trajectory.size());
  for (std::size_t i = 0; i < a.trajectory.size(); ++i) {
    const Eigen::Matrix4d Ta = a.trajectory[i].T_world_camera.matrix();
    const Eigen::Matrix4d Tb = b.trajectory[i].T_world_camera.matrix();
    EXPECT_EQ(std::memcmp(Ta.data(), Tb.data(), sizeof(double) * 16), 0) << i;
  }
  ASSERT_EQ(a.map->landmarks.size(), b.map->landmarks.size());
  for (auto i = a.map->landmarks.begin(), j = b.map->landmarks.begin(); i != a.map->landmarks.end();
       ++i, ++j) {
    EXPECT_EQ(i->p_world, j->p_world);
  }
}

TEST(Backend, ClaimedCovarianceMatchesTheError) {
  // Error of each event's position relative to the segment's start, in units of what is claimed.
  std::vector<double> normalised;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    Simulation s = sideways();
    s.seed = seed;
    s.outliers = 0.05;
    const Flight flight = test::Simulator(s).fly();
    BackendOptions options;
    options.final_adjustment = false;
    const Outcome r = run_backend(flight, IntrinsicsOrigin::calibration, 1, options);
    // The world is the first keyframe; only the scale is free.
    const Pose T_first = flight.truth[0];
    const double scale = r.ate.alignment.T_target_source.scale();
    for (std::size_t i = 60; i < r.events.size(); i += 7) {
      if (!r.events[i].T_world_camera) continue;
      const Pose truth = T_first.inverse() * flight.truth[i];
      const Pose scaled(truth.rotation(), truth.translation() / scale);
      const Vector6d error = (r.events[i].T_world_camera->inverse() * scaled).log();
      normalised.push_back(error.dot(r.events[i].covariance.ldlt().solve(error)) / 6);
    }
  }
  ASSERT_GT(normalised.size(), 30U);
  std::sort(normalised.begin(), normalised.end());
  const double middle = normalised[normalised.size() / 2];
  std::cout << "  normalised squared error per degree of freedom: median " << middle << ", 90 % "
            << normalised[normalised.size() * 9 / 10] << "\n";
  EXPECT_GT(middle, 0.05);
  EXPECT_LT(middle, 10);
}

TEST(Backend, SnapshotsAreConsistentAndImmutable) {
  const Flight flight = test::Simulator(sideways()).fly();
  Backend backend({}, IntrinsicsOrigin::calibration, 1);
  EXPECT_TRUE(backend.map()->keyframes.empty());
  ASSERT_NE(backend.motion(), nullptr);
  std::shared_ptr<const MapSnapshot> before;
  std::vector<Eigen::Vector3d> copy;
  for (std::size_t i = 0; i < flight.frames.size(); ++i) {
    const PoseEvent e = backend.add(flight.frames[i]);
    EXPECT_FALSE(backend.last_timings_ms().empty() && e.T_world_camera);
    const auto motion = backend.motion();
    if (e.T_world_camera) {
      ASSERT_FALSE(motion->recent.empty());
      EXPECT_EQ(motion->recent.back().time_ns, e.time_ns);
      EXPECT_LT(
          (motion->recent.back().T_world_camera.translation() - e.T_world_camera->translation())
              .norm(),
          1e-12);
      EXPECT_TRUE(std::is_sorted(motion->landmarks.begin(), motion->landmarks.end(),
                                 [](const auto& a, const auto& b) { return a.first < b.first; }));
    }
    if (i == 60) {
      before = backend.map();
      for (const Landmark& l : before->landmarks) copy.push_back(l.p_world);
    }
  }
  ASSERT_FALSE(copy.empty());
  auto kept = copy.begin();
  for (const Landmark& l : before->landmarks) EXPECT_EQ(*kept++, l.p_world);
  const auto map = backend.map();
  EXPECT_GT(map->version, before->version);
  for (std::size_t k = 0; k < map->keyframes.size(); ++k) {
    EXPECT_EQ(map->keyframes[k]->id.value, k);
    EXPECT_TRUE(std::is_sorted(
        map->keyframes[k]->observations.begin(), map->keyframes[k]->observations.end(),
        [](const auto& a, const auto& b) { return a.landmark < b.landmark; }));
    for (const Observation& o : map->keyframes[k]->observations) {
      ASSERT_NE(map->find(o.landmark), nullptr);
    }
  }
  for (const Landmark& l : map->landmarks) {
    EXPECT_GE(l.observations, 2);
    EXPECT_GT(l.max_ray_angle_rad, 0);
  }
}

TEST(Backend, SurvivesBrokenObservations) {
  Flight flight = test::Simulator(sideways()).fly();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (std::size_t i = 0; i < flight.frames.size(); i += 3) {
    for (std::size_t k = 0; k < flight.frames[i].observations.size(); k += 11) {
      flight.frames[i].observations[k].pixel = {nan, 1e12};
      flight.frames[i].observations[k].covariance_px2 *= -1;
    }
  }
  const Outcome r = run_backend(flight);
  EXPECT_EQ(r.untracked_after_start(), 0U);
  EXPECT_LT(r.ate.rmse(), 0.02);
}

}  // namespace
}  // namespace corvid
