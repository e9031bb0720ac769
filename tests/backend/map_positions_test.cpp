#include "backend/map_positions.h"

#include <gtest/gtest.h>

#include <cmath>
#include <iostream>
#include <limits>

#include "backend/backend.h"
#include "backend/simulator.h"

namespace corvid {
namespace {

using test::Flight;
using test::Simulation;

const GeodeticPosition kOrigin{47.3977, 8.5456, 488};

/// Where the simulated world lies on Earth: z of its cameras looks down.
Eigen::Vector3d on_earth(const Eigen::Vector3d& p) { return {p.x(), -p.y(), -p.z()}; }

/// A long winding flight with a calibration that is a little wrong: its map bends and drifts in
/// scale.
Simulation drifting() {
  Simulation s;
  s.camera = test::radtan_camera();
  s.path = [](double t) {
    return Pose(so3_exp({0.02 * std::sin(9 * t), 0.02 * std::cos(7 * t), 0}),
                Eigen::Vector3d(250 * t, 6 * std::sin(14 * t), 2 * std::sin(9 * t)));
  };
  s.frames = 1000;
  s.tracks = 150;
  s.noise_px = 0.8;
  s.believed = s.camera;
  s.believed.distortion[0] += 0.003;
  s.death = 0.03;
  return s;
}

struct Receiver {
  double sigma_m = 0.3;
  double outliers = 0.1;
  int every = 2;  // frames
  std::uint64_t seed = 4;

  [[nodiscard]] std::vector<PositionFix> listen(const Flight& flight) const {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    std::uniform_real_distribution<double> uniform(-1, 1);
    const LocalFrame frame(kOrigin);
    std::vector<PositionFix> out;
    for (std::size_t i = 0; i < flight.frames.size(); i += static_cast<std::size_t>(every)) {
      Eigen::Vector3d p = on_earth(flight.truth[i].translation()) +
                          sigma_m * Eigen::Vector3d(normal(random), normal(random), normal(random));
      if (0.5 * (uniform(random) + 1) < outliers)
        p += 100 * Eigen::Vector3d(uniform(random), uniform(random), uniform(random));
      PositionFix fix;
      fix.time_ns = flight.frames[i].frame->time_ns;
      fix.position = to_geodetic(frame.to_ecef(p));
      fix.covariance_m2 = sigma_m * sigma_m * Eigen::Matrix3d::Identity();
      out.push_back(fix);
    }
    return out;
  }
};

struct Outcome {
  std::vector<PoseEvent> events;
  Trajectory trajectory;
  std::vector<MapPlacement> placements;
  double worst_live_m = 0;  // of the poses that were published as metric
  double rmse_final_m = 0;  // of the final trajectory in ENU, if metric
  std::size_t metric_events = 0;
};

/// @param fixes  each is pushed with the first frame at or after its time.
Outcome fly(const Flight& flight, const std::vector<PositionFix>& fixes, bool all_at_once = false) {
  Backend backend(BackendOptions{}, IntrinsicsOrigin::calibration, 1);
  Outcome r;
  if (all_at_once) backend.add_positions(fixes);
  std::size_t next = all_at_once ? fixes.size() : 0;
  const auto truth_enu = [&](std::size_t i, const GeodeticPosition& origin) {
    return LocalFrame(origin).to_enu(
        LocalFrame(kOrigin).to_ecef(on_earth(flight.truth[i].translation())));
  };
  for (std::size_t i = 0; i < flight.frames.size(); ++i) {
    const std::size_t first = next;
    while (next < fixes.size() && fixes[next].time_ns <= flight.frames[i].frame->time_ns) ++next;
    backend.add_positions(std::span(fixes).subspan(first, next - first));
    r.events.push_back(backend.add(flight.frames[i]));
    const PoseEvent& e = r.events.back();
    if (e.scale != MapScale::metric || !e.T_world_camera) continue;
    ++r.metric_events;
    const Pose T = e.placement->T_enu_map * *e.T_world_camera;
    r.worst_live_m =
        std::max(r.worst_live_m, (T.translation() - truth_enu(i, e.placement->origin)).norm());
  }
  backend.finish();
  r.trajectory = backend.trajectory();
  r.placements = backend.placements();
  const MapPlacement& last = r.placements.back();
  double squares = 0;
  for (std::size_t i = 0, k = 0; i < flight.frames.size(); ++i) {
    if (k >= r.trajectory.size() || r.trajectory[k].time_ns != flight.frames[i].frame->time_ns)
      continue;
    const Pose T = last.T_enu_map * r.trajectory[k++].T_world_camera;
    squares += (T.translation() - truth_enu(i, last.origin)).squaredNorm();
  }
  r.rmse_final_m = std::sqrt(squares / static_cast<double>(r.trajectory.size()));
  const auto ate = test::absolute_error(r.trajectory, flight);
  std::cout << "  " << to_string(last.scale) << " " << last.reason << ", metric events "
            << r.metric_events << " of " << r.events.size() << ", worst live " << r.worst_live_m
            << " m, final " << r.rmse_final_m << " m, Sim(3) " << ate.rmse() << " m, inliers "
            << last.inliers << " of " << last.positions << "; " << r.events.back().reason << "\n";
  return r;
}

TEST(MapPositions, BoundTheDriftOfALongFlight) {
  const Flight flight = test::Simulator(drifting()).fly();
  const Outcome without = fly(flight, {});
  EXPECT_EQ(without.metric_events, 0U);
  EXPECT_EQ(without.placements.back().scale, MapScale::arbitrary);
  EXPECT_FALSE(without.placements.back().reason.empty());
  const double drift_m = test::absolute_error(without.trajectory, flight).rmse();

  const Outcome with = fly(flight, Receiver{}.listen(flight));
  EXPECT_EQ(with.placements.back().scale, MapScale::metric);
  EXPECT_GT(drift_m, 1.5);  // otherwise this flight shows nothing
  EXPECT_LT(with.rmse_final_m, 0.5);
  EXPECT_LT(with.worst_live_m, 2.5);
  EXPECT_GT(with.metric_events, flight.frames.size() / 2);
}

/// A shorter one, whose map hardly drifts.
Flight short_flight(double bends = 6) {
  Simulation s;
  s.camera = test::radtan_camera();
  s.path = [bends](double t) {
    return Pose(so3_exp({0.02 * std::sin(9 * t), 0.02 * std::cos(7 * t), 0}),
                Eigen::Vector3d(60 * t, bends * std::sin(9 * t), 0.4 * bends * std::sin(6 * t)));
  };
  s.frames = 240;
  s.tracks = 200;
  return test::Simulator(s).fly();
}

TEST(MapPositions, LateShuffledDuplicatedAndBrokenFixesCountOnce) {
  const Flight flight = short_flight();
  const std::vector<PositionFix> fixes = Receiver{}.listen(flight);
  const Outcome in_order = fly(flight, fixes, true);
  ASSERT_EQ(in_order.placements.back().scale, MapScale::metric)
      << in_order.placements.back().reason;
  EXPECT_LT(in_order.rmse_final_m, 0.3);

  std::vector<PositionFix> messy = fixes;
  messy.insert(messy.end(), fixes.begin(), fixes.end());
  for (std::size_t i = 0; i < 20; ++i) {
    PositionFix broken = fixes[i];
    broken.time_ns += 1'000'000;
    if (i % 4 == 0) broken.position.latitude_deg = std::numeric_limits<double>::quiet_NaN();
    if (i % 4 == 1) broken.position.latitude_deg = 91;
    if (i % 4 == 2) broken.covariance_m2.setZero();
    if (i % 4 == 3) broken.covariance_m2.setConstant(std::numeric_limits<double>::infinity());
    messy.push_back(broken);
  }
  std::mt19937_64 random(1);
  for (std::size_t k = messy.size(); k > 1; --k) std::swap(messy[k - 1], messy[random() % k]);
  const Outcome shuffled = fly(flight, messy, true);
  ASSERT_EQ(shuffled.trajectory.size(), in_order.trajectory.size());
  const Sim3 difference =
      shuffled.placements.back().T_enu_map.inverse() * in_order.placements.back().T_enu_map;
  EXPECT_LT(difference.log().norm(), 1e-9);

  // Each fix two seconds after its time.
  std::vector<PositionFix> late = fixes;
  Backend backend(BackendOptions{}, IntrinsicsOrigin::calibration, 1);
  std::size_t next = 0;
  for (const FrameTracks& tracks : flight.frames) {
    const std::size_t first = next;
    while (next < late.size() && late[next].time_ns + 2'000'000'000 <= tracks.frame->time_ns)
      ++next;
    backend.add_positions(std::span(late).subspan(first, next - first));
    (void)backend.add(tracks);
  }
  backend.add_positions(std::span(late).subspan(next));
  backend.finish();
  ASSERT_EQ(backend.placements().back().scale, MapScale::metric);
  EXPECT_EQ(backend.placements().back().positions, in_order.placements.back().positions);
}

TEST(MapPositions, StraightFlightSaysThatItWaits) {
  const Flight flight = short_flight(0);
  const Outcome r = fly(flight, Receiver{}.listen(flight));
  EXPECT_EQ(r.metric_events, 0U);
  EXPECT_NE(r.events.back().placement->reason.find("straight"), std::string::npos)
      << r.events.back().placement->reason;
}

TEST(MapPositions, NothingIsMadeOfFewOrOfWrongFixes) {
  const Flight flight = short_flight();
  auto fixes = Receiver{}.listen(flight);
  const Outcome few = fly(flight, {fixes.begin(), fixes.begin() + 8});
  EXPECT_EQ(few.metric_events, 0U);
  EXPECT_FALSE(few.events.back().placement->reason.empty());

  Receiver broken;
  broken.outliers = 1;
  const Outcome wrong = fly(flight, broken.listen(flight));
  EXPECT_EQ(wrong.metric_events, 0U);
  EXPECT_EQ(wrong.placements.back().scale, MapScale::arbitrary);
}

TEST(MapPositions, FirstFixFarAwayIsNotTheOrigin) {
  const Flight flight = short_flight();
  auto fixes = Receiver{}.listen(flight);
  fixes.front().position.latitude_deg += 3;
  const Outcome r = fly(flight, fixes, true);
  ASSERT_EQ(r.placements.back().scale, MapScale::metric) << r.placements.back().reason;
  EXPECT_NEAR(r.placements.back().origin.latitude_deg, kOrigin.latitude_deg, 0.01);
  EXPECT_LT(r.rmse_final_m, 0.3);
}

TEST(MapPositions, SlowFixesAreInterpolatedOverShortGapsOnly) {
  const Flight flight = short_flight();
  Receiver slow;
  slow.every = 20;  // 1 Hz
  slow.outliers = 0;
  const auto fixes = slow.listen(flight);
  const Outcome r = fly(flight, fixes, true);
  ASSERT_EQ(r.placements.back().scale, MapScale::metric) << r.placements.back().reason;
  EXPECT_LT(r.rmse_final_m, 0.5);
  slow.every = 60;  // 3 s apart: only keyframes at a fix have a position
  const Outcome gaps = fly(flight, slow.listen(flight), true);
  EXPECT_LE(gaps.placements.back().positions, 4);
}

TEST(MapPositions, OfAFrameByItsName) {
  Flight flight = short_flight();
  auto fixes = Receiver{}.listen(flight);
  std::size_t next = 0;
  for (std::size_t i = 0; i < flight.frames.size(); ++i) {
    Frame named = *flight.frames[i].frame;
    named.name = "image_" + std::to_string(i) + ".jpg";
    if (next < fixes.size() && fixes[next].time_ns == named.time_ns) {
      fixes[next].frame_name = named.name;
      fixes[next++].time_ns = 0;
    }
    flight.frames[i].frame = std::make_shared<const Frame>(std::move(named));
  }
  ASSERT_EQ(next, fixes.size());
  const Outcome r = fly(flight, fixes, true);
  ASSERT_EQ(r.placements.back().scale, MapScale::metric) << r.placements.back().reason;
  EXPECT_LT(r.rmse_final_m, 0.3);
}

TEST(MapPositions, TimesOfAllClocks) {
  constexpr auto kLeast = std::numeric_limits<std::int64_t>::min();
  constexpr auto kMost = std::numeric_limits<std::int64_t>::max();
  const auto fix_at = [](std::int64_t time_ns) {
    PositionFix fix;
    fix.time_ns = time_ns;
    fix.position = kOrigin;
    return fix;
  };
  const auto add_keyframe = [](MapData& map, std::int64_t time_ns) {
    Frame frame;
    frame.time_ns = time_ns;
    map.add_keyframe(std::make_shared<const Frame>(frame), 0, Pose(), {});
  };
  struct Pair {
    std::int64_t frame_ns, fix_ns;
  };
  for (const auto& [frame_ns, fix_ns] : {Pair{kLeast, 0}, Pair{kLeast, kMost}, Pair{kMost, -5},
                                         Pair{kLeast, kLeast}, Pair{kMost, kMost}}) {
    MapPositions positions{BackendOptions()};
    MapData map;
    add_keyframe(map, frame_ns);
    positions.add(std::vector{fix_at(fix_ns)});
    positions.follow(map, 0);
    EXPECT_EQ(positions.placement(0)->positions, frame_ns == fix_ns ? 1 : 0)
        << frame_ns << ", " << fix_ns;
  }

  // What an early keyframe leaves behind is not needed any more; what comes after it is.
  MapPositions positions{BackendOptions()};
  MapData map;
  for (const std::int64_t time_ns : {kLeast, std::int64_t{0}}) add_keyframe(map, time_ns);
  positions.add(std::vector{fix_at(0), fix_at(1'000'000'000)});
  positions.follow(map, 0);
  EXPECT_EQ(positions.placement(0)->positions, 1);
  add_keyframe(map, 500'000'000);
  positions.follow(map, 0);
  EXPECT_EQ(positions.placement(0)->positions, 2);
}

}  // namespace
}  // namespace corvid
