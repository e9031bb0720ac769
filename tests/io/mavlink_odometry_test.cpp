#include <gtest/gtest.h>

#include <numbers>
#include <random>
#include <vector>

#include "io/mavlink/body_pose.h"
#include "io/mavlink/odometry_stream.h"
#include "tests/io/mavlink_poses.h"

namespace corvid {
namespace {

using mavlink::Odometry;
using test::kMs;
using test::some_placement;
using test::SteadyFlight;
using test::tracked;

constexpr double kPi = std::numbers::pi;

/// Position and turning of the body by which b differs from a.
Vector6d difference(const Pose& a, const Pose& b) {
  Vector6d d;
  d.head<3>() = b.translation() - a.translation();
  d.tail<3>() = so3_log(b.rotation() * a.rotation().conjugate());
  return d;
}

Matrix6d full(const mavlink::Covariance21& upper) {
  Matrix6d m;
  std::size_t at = 0;
  for (int r = 0; r < 6; ++r) {
    for (int c = r; c < 6; ++c) m(r, c) = m(c, r) = upper[at++];
  }
  return m;
}

Eigen::Vector3d position(const Odometry& m) { return {m.x, m.y, m.z}; }
Eigen::Vector3d velocity(const Odometry& m) { return {m.vx, m.vy, m.vz}; }
Eigen::Vector3d rates(const Odometry& m) { return {m.rollspeed, m.pitchspeed, m.yawspeed}; }
Eigen::Quaterniond attitude(const Odometry& m) { return {m.q[0], m.q[1], m.q[2], m.q[3]}; }

/// The map is ENU itself.
std::shared_ptr<MapPlacement> plain_placement() {
  auto placement = std::make_shared<MapPlacement>();
  placement->scale = MapScale::metric;
  return placement;
}

// ---- axes, typed by hand
// -------------------------------------------------------------------------

TEST(MavlinkBodyPose, MountsAreWhatTheirNamesSay) {
  const Eigen::Matrix3d forward = camera_mount(0, 0, 0).toRotationMatrix();
  EXPECT_TRUE(forward.col(0).isApprox(Eigen::Vector3d(0, 1, 0), 1e-12)) << "right is right";
  EXPECT_TRUE(forward.col(1).isApprox(Eigen::Vector3d(0, 0, 1), 1e-12)) << "down is down";
  EXPECT_TRUE(forward.col(2).isApprox(Eigen::Vector3d(1, 0, 0), 1e-12)) << "it looks forward";
  const Eigen::Matrix3d down = camera_mount(0, -kPi / 2, 0).toRotationMatrix();
  EXPECT_TRUE(down.col(0).isApprox(Eigen::Vector3d(0, 1, 0), 1e-12));
  EXPECT_TRUE(down.col(1).isApprox(Eigen::Vector3d(-1, 0, 0), 1e-12)) << "upper edge in front";
  EXPECT_TRUE(down.col(2).isApprox(Eigen::Vector3d(0, 0, 1), 1e-12)) << "it looks down";
  const Eigen::Matrix3d right = camera_mount(0, 0, kPi / 2).toRotationMatrix();
  EXPECT_TRUE(right.col(2).isApprox(Eigen::Vector3d(0, 1, 0), 1e-12)) << "yaw is to the right";
  const Eigen::Matrix3d rolled = camera_mount(kPi / 2, 0, 0).toRotationMatrix();
  EXPECT_TRUE(rolled.col(0).isApprox(Eigen::Vector3d(0, 0, 1), 1e-12)) << "its right is below";
}

TEST(MavlinkBodyPose, NorthEastDown) {
  // In ENU: the camera at 3 east, 4 north, 5 up, looking east with its picture upright.
  Eigen::Matrix3d R_enu_camera;
  R_enu_camera.col(0) = Eigen::Vector3d(0, -1, 0);  // right is south
  R_enu_camera.col(1) = Eigen::Vector3d(0, 0, -1);  // down
  R_enu_camera.col(2) = Eigen::Vector3d(1, 0, 0);   // east
  const Pose T(R_enu_camera, Eigen::Vector3d(3, 4, 5));
  // Forward: the vehicle heads east, a yaw of 90 degrees. The camera is 1 m in front of its centre.
  const Pose mount(camera_mount(0, 0, 0), Eigen::Vector3d(1, 0, 0));
  const BodyPose b = body_pose(T, Matrix6d::Zero(), *plain_placement(), mount);
  EXPECT_TRUE(b.T_ned_body.translation().isApprox(Eigen::Vector3d(4, 2, -5), 1e-12));
  EXPECT_NEAR(b.T_ned_body.rotation().angularDistance(
                  Eigen::Quaterniond(Eigen::AngleAxisd(kPi / 2, Eigen::Vector3d::UnitZ()))),
              0, 1e-12);
  // Mounted looking right, the same camera means a vehicle that heads north.
  const BodyPose side = body_pose(T, Matrix6d::Zero(), *plain_placement(),
                                  Pose(camera_mount(0, 0, kPi / 2), Eigen::Vector3d::Zero()));
  EXPECT_NEAR(side.T_ned_body.rotation().angularDistance(Eigen::Quaterniond::Identity()), 0, 1e-12);
  EXPECT_TRUE(side.T_ned_body.translation().isApprox(Eigen::Vector3d(4, 3, -5), 1e-12));
}

TEST(MavlinkBodyPose, CovarianceIsThatOfFiniteDifferences) {
  const auto placement = some_placement();
  const Pose T = SteadyFlight().at(0.7);
  const Pose mount(camera_mount(0.2, -1.1, 0.4), Eigen::Vector3d(0.3, -0.5, 0.2));
  const Matrix6d covariance = test::some_covariance();
  const BodyPose body = body_pose(T, covariance, *placement, mount);
  constexpr double h = 1e-6;
  Eigen::Matrix<double, 6, 13> d;
  for (int i = 0; i < 13; ++i) {
    const auto moved = [&](double step) {
      Pose T2 = T;
      MapPlacement P2 = *placement;
      if (i < 6) {
        T2 = T * Pose::exp(step * Vector6d::Unit(i));
      } else {
        P2.T_enu_map = P2.T_enu_map * Sim3::exp(step * Vector7d::Unit(i - 6));
      }
      return body_pose(T2, covariance, P2, mount).T_ned_body;
    };
    d.col(i) = difference(moved(-h), moved(h)) / (2 * h);
  }
  Eigen::Matrix<double, 13, 13> all = Eigen::Matrix<double, 13, 13>::Zero();
  all.topLeftCorner<6, 6>() = covariance;
  all.bottomRightCorner<7, 7>() = placement->covariance;
  const Matrix6d expected = d * all * d.transpose();
  EXPECT_LT((body.covariance - expected).norm(), 1e-6 * expected.norm());
}

// ---- what is sent, and when
// ----------------------------------------------------------------------

OdometryOptions measured_only() {
  OdometryOptions options;
  options.rate_hz = 0;
  return options;
}

/// Adds a steady flight's poses at 20 Hz, each 40 ms after its time; what came of each.
std::vector<std::optional<Odometry>> fly(
    OdometryStream* stream, int poses, int first = 0,
    std::shared_ptr<const MapPlacement> placement = some_placement()) {
  std::vector<std::optional<Odometry>> out;
  for (int i = first; i < first + poses; ++i) {
    const std::int64_t time_ns = 1'000 * kMs + i * 50 * kMs;
    out.push_back(
        stream->add(tracked(time_ns, SteadyFlight().at(0.05 * i), placement), time_ns + 40 * kMs));
  }
  return out;
}

TEST(MavlinkOdometry, NothingBeforeTheScaleIsMetric) {
  OdometryStream stream({});
  auto arbitrary = some_placement();
  arbitrary->scale = MapScale::arbitrary;
  for (const auto& m : fly(&stream, 50, 0, arbitrary)) EXPECT_FALSE(m);
  PoseEvent no_placement = tracked(3600 * kMs, SteadyFlight().at(1));
  no_placement.placement = nullptr;
  EXPECT_FALSE(stream.add(no_placement, 3640 * kMs));
  EXPECT_FALSE(stream.due_ns());
  EXPECT_FALSE(stream.extrapolate(INT64_MAX));
  EXPECT_EQ(stream.counts().measured, 0U);
  const auto metric = fly(&stream, 3, 60);
  EXPECT_FALSE(metric[0]) << "one pose has no velocity";
  EXPECT_TRUE(metric[1] && metric[2]);
}

TEST(MavlinkOdometry, FieldsOfASteadyFlight) {
  OdometryOptions options = measured_only();
  options.T_body_camera = Pose(camera_mount(0, -kPi / 2, 0), Eigen::Vector3d(0.2, 0, 0.1));
  OdometryStream stream(options);
  const auto placement = some_placement();
  const auto sent = fly(&stream, 12, 0, placement);
  ASSERT_TRUE(sent[11]);
  const Odometry& m = *sent[11];
  EXPECT_EQ(m.time_usec, 1'000'000U + 11 * 50'000);
  EXPECT_EQ(m.frame_id, mavlink::Frame::local_frd);
  EXPECT_EQ(m.child_frame_id, mavlink::Frame::body_frd);
  EXPECT_EQ(m.estimator_type, 2);
  EXPECT_EQ(m.quality, 100);
  const SteadyFlight flight;
  const auto body = [&](double t_s) {
    return body_pose(flight.at(t_s), test::some_covariance(), *placement, options.T_body_camera);
  };
  const BodyPose expected = body(0.55);
  EXPECT_TRUE(position(m).isApprox(expected.T_ned_body.translation(), 1e-6));
  EXPECT_NEAR(attitude(m).angularDistance(expected.T_ned_body.rotation()), 0, 1e-6);
  EXPECT_GE(m.q[0], 0);
  EXPECT_TRUE(full(m.pose_covariance).isApprox(expected.covariance, 1e-6));
  // The body's velocity by differentiation; the mean over the last interval was half of it ago.
  constexpr double h = 1e-5;
  const Eigen::Vector3d v_ned =
      (body(0.525 + h).T_ned_body.translation() - body(0.525 - h).T_ned_body.translation()) /
      (2 * h);
  EXPECT_TRUE(velocity(m).isApprox(expected.T_ned_body.rotation().conjugate() * v_ned, 1e-4));
  EXPECT_TRUE(rates(m).isApprox(options.T_body_camera.rotation() * flight.omega, 1e-5));
}

TEST(MavlinkOdometry, VelocitysCovarianceIsUnknownAtFirstAndThenBoundsItsError) {
  // Noisy poses of a steady flight: the velocity's error is known.
  std::mt19937 random(11);
  std::normal_distribution<double> noise(0, 0.004);
  OdometryStream stream(measured_only());
  const auto placement = plain_placement();
  const Eigen::Vector3d v(3, -1, 0.5);
  double squares = 0, claimed = 0;
  int n = 0;
  for (int i = 0; i < 400; ++i) {
    const std::int64_t t = i * 50 * kMs;
    const Eigen::Vector3d p =
        v * (0.05 * i) + Eigen::Vector3d(noise(random), noise(random), noise(random));
    const auto m = stream.add(tracked(t, Pose(camera_mount(0, 0, 0), p), placement), t);
    if (!m) continue;
    if (i < 1 + OdometryStream::kLeastChanges) {
      EXPECT_TRUE(std::isnan(m->velocity_covariance[0])) << i;
      continue;
    }
    const Eigen::Vector3d v_ned = attitude(*m) * velocity(*m);
    squares += (v_ned - Eigen::Vector3d(v.y(), v.x(), -v.z())).squaredNorm();
    claimed += full(m->velocity_covariance).topLeftCorner<3, 3>().trace();
    ++n;
  }
  ASSERT_GT(n, 300);
  EXPECT_NEAR(claimed / squares, 1, 0.25) << "white noise of the poses: it is the bound itself";
}

TEST(MavlinkOdometry, ScalesUncertaintyIsInTheVelocitys) {
  OdometryStream stream(measured_only());
  auto placement = plain_placement();
  placement->covariance(6, 6) = 0.02 * 0.02;
  const auto sent = fly(&stream, 12, 0, placement);
  const double sigma = std::sqrt(full(sent[11]->velocity_covariance).topLeftCorner<3, 3>().trace());
  EXPECT_NEAR(sigma, 0.02 * velocity(*sent[11]).norm(), 1e-3 * sigma);
}

TEST(MavlinkOdometry, ResetsAreCountedModulo256AndInterruptTheVelocity) {
  OdometryStream stream(measured_only());
  int at = 0;
  for (const auto& [resets, expected] : std::vector<std::pair<std::uint64_t, int>>{
           {0, 0}, {1, 1}, {255, 255}, {256, 0}, {700, 188}}) {
    for (int i = 0; i < 3; ++i, ++at) {
      // Each reset comes with a jump, which must not look like a velocity.
      Pose T = SteadyFlight().at(0.05 * at);
      T = Pose(T.rotation(), T.translation() + Eigen::Vector3d(static_cast<double>(resets), 0, 0));
      PoseEvent event = tracked(at * 50 * kMs, T);
      event.resets = resets;
      const auto m = stream.add(event, event.time_ns);
      ASSERT_EQ(m.has_value(), i > 0);
      if (!m) continue;
      EXPECT_EQ(m->reset_counter, expected);
      EXPECT_LT(velocity(*m).norm(), 2.5 * 2);
    }
  }
}

TEST(MavlinkOdometry, AMapPlacedFarFromWhereItWasIsAReset) {
  OdometryStream stream(measured_only());
  const auto first = fly(&stream, 3);
  auto near = some_placement();
  near->T_enu_map = Sim3(2.5, near->T_enu_map.rotation(),
                         near->T_enu_map.translation() + Eigen::Vector3d(0.05, 0, 0));
  const auto second = fly(&stream, 3, 3, near);
  auto far = some_placement();
  far->T_enu_map = Sim3(2.5, far->T_enu_map.rotation(),
                        far->T_enu_map.translation() + Eigen::Vector3d(0, 30, 0));
  const auto third = fly(&stream, 3, 6, far);
  EXPECT_EQ(first[2]->reset_counter, 0);
  EXPECT_EQ(second[0]->reset_counter, 0) << "within what was said to be uncertain";
  EXPECT_EQ(third[0]->reset_counter, 1);
  EXPECT_EQ(third[2]->reset_counter, 1);
  // The velocity never holds the jump of the placement.
  EXPECT_NEAR(velocity(*third[0]).norm(), velocity(*first[2]).norm(), 1e-3);
}

TEST(MavlinkOdometry, NothingWhileLostAndNoVelocityAcrossIt) {
  OdometryStream stream({});
  fly(&stream, 10);
  ASSERT_TRUE(stream.due_ns());
  EXPECT_FALSE(stream.add(test::lost(1500 * kMs, "blank wall"), 1540 * kMs));
  EXPECT_FALSE(stream.due_ns()) << "no extrapolation of a lost camera";
  const auto again = fly(&stream, 2, 11);
  EXPECT_FALSE(again[0]);
  EXPECT_TRUE(again[1]);
}

TEST(MavlinkOdometry, BadEventsAreLeftOut) {
  OdometryStream stream({});
  fly(&stream, 10);
  PoseEvent nan = tracked(1500 * kMs, SteadyFlight().at(0.5));
  nan.T_world_camera = Pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(NAN, 0, 0));
  EXPECT_FALSE(stream.add(nan, 1540 * kMs));
  // The same time twice, a time that went back.
  fly(&stream, 3, 11);
  EXPECT_FALSE(stream.add(tracked(1650 * kMs, SteadyFlight().at(0.65)), 1690 * kMs));
  EXPECT_FALSE(stream.add(tracked(1600 * kMs, SteadyFlight().at(0.6)), 1700 * kMs));
  // Another clock.
  EXPECT_FALSE(stream.add(tracked(INT64_MIN, Pose()), 1700 * kMs));
  EXPECT_FALSE(stream.add(tracked(INT64_MAX, Pose()), 1700 * kMs));
  EXPECT_EQ(stream.counts().stale, 2U);
  // Too large for the message.
  OdometryStream far(measured_only());
  for (int i = 0; i < 3; ++i) {
    EXPECT_FALSE(far.add(
        tracked(i * 50 * kMs, Pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(1e300, 0, 0))),
        i * 50 * kMs));
  }
  // A covariance that is none is not passed on.
  OdometryStream unknown(measured_only());
  for (int i = 0; i < 3; ++i) {
    PoseEvent event = tracked(i * 50 * kMs, SteadyFlight().at(0.05 * i));
    event.covariance(3, 3) = NAN;
    const auto m = unknown.add(event, event.time_ns);
    if (m) {
      EXPECT_TRUE(std::isnan(m->pose_covariance[0]));
      EXPECT_EQ(m->pose_covariance[6], 0);
    }
  }
  EXPECT_EQ(unknown.counts().measured, 2U);
}

TEST(MavlinkOdometry, ExtrapolatesBetweenPosesAtTheRateOrMore) {
  OdometryStream stream({});  // 30 Hz, the camera 20 Hz
  std::vector<Odometry> sent;
  std::vector<std::int64_t> sent_at_ns;
  for (int i = 0; i < 60; ++i) {
    const std::int64_t time_ns = i * 50 * kMs, arrival_ns = time_ns + 40 * kMs;
    for (auto due = stream.due_ns(); due && *due < arrival_ns; due = stream.due_ns()) {
      const auto m = stream.extrapolate(*due);
      ASSERT_TRUE(m);
      sent.push_back(*m);
      sent_at_ns.push_back(*due);
    }
    if (const auto m = stream.add(tracked(time_ns, SteadyFlight().at(0.05 * i)), arrival_ns)) {
      sent.push_back(*m);
      sent_at_ns.push_back(arrival_ns);
    }
  }
  EXPECT_EQ(stream.counts().measured, 59U) << "every measured pose goes out";
  EXPECT_EQ(stream.counts().late, 0U);
  EXPECT_GE(stream.counts().extrapolated, 50U);
  const auto placement = some_placement();
  for (std::size_t i = 1; i < sent.size(); ++i) {
    const double gap_s = 1e-6 * static_cast<double>(sent[i].time_usec - sent[i - 1].time_usec);
    EXPECT_GT(sent[i].time_usec, sent[i - 1].time_usec) << "autopilots drop what is older";
    if (i > 20) {
      EXPECT_LT(gap_s, 1.0 / 30) << i;
    }
    EXPECT_EQ(sent_at_ns[i] - 1000 * static_cast<std::int64_t>(sent[i].time_usec), 40 * kMs);
    // A steady flight is extrapolated to where it will be.
    const BodyPose there =
        body_pose(SteadyFlight().at(1e-6 * static_cast<double>(sent[i].time_usec)),
                  test::some_covariance(), *placement, OdometryOptions{}.T_body_camera);
    EXPECT_LT((position(sent[i]) - there.T_ned_body.translation()).norm(), 1e-4);
    EXPECT_LT(attitude(sent[i]).angularDistance(there.T_ned_body.rotation()), 1e-4);
  }
}

TEST(MavlinkOdometry, ExtrapolationEndsAQuarterOfASecondBeyondTheLastPose) {
  OdometryStream stream({});
  fly(&stream, 10);
  const std::int64_t last_ns = 1450 * kMs;
  int n = 0;
  std::uint64_t newest_us = 0;
  for (auto due = stream.due_ns(); due; due = stream.due_ns(), ++n) {
    ASSERT_LT(n, 100);
    newest_us = stream.extrapolate(*due)->time_usec;
  }
  EXPECT_GE(n, 7);
  EXPECT_LE(static_cast<std::int64_t>(newest_us) * 1000, last_ns + 250 * kMs);
  EXPECT_GT(static_cast<std::int64_t>(newest_us) * 1000, last_ns + 200 * kMs);
  EXPECT_FALSE(stream.extrapolate(INT64_MAX));
}

TEST(MavlinkOdometry, AThreadThatSleptSendsOnlyTheNewest) {
  OdometryStream stream({});
  fly(&stream, 10);
  const auto m = stream.extrapolate(1490 * kMs + 130 * kMs);
  ASSERT_TRUE(m);
  EXPECT_GT(m->time_usec, 1'450'000U + 90'000);
  EXPECT_FALSE(stream.extrapolate(1490 * kMs + 130 * kMs));
}

TEST(MavlinkOdometry, APoseOvertakenByAnExtrapolationOnlyCorrectsTheNext) {
  OdometryStream stream({});
  fly(&stream, 10);
  // The next pose, of 1500 ms, comes 200 ms late.
  ASSERT_TRUE(stream.extrapolate(1490 * kMs + 150 * kMs));
  EXPECT_FALSE(stream.add(tracked(1500 * kMs, SteadyFlight().at(0.5)), 1740 * kMs));
  EXPECT_EQ(stream.counts().late, 1U);
  const auto due = stream.due_ns();
  ASSERT_TRUE(due);
  const auto m = stream.extrapolate(*due);
  ASSERT_TRUE(m);
  EXPECT_GT(m->time_usec, 1'450'000U + 137'000) << "later than what was sent";
}

TEST(MavlinkOdometry, NoExtrapolationsForARateOfZeroNorForAFastCamera) {
  OdometryStream stream(measured_only());
  fly(&stream, 10);
  EXPECT_FALSE(stream.due_ns());
  OdometryStream fast({});
  for (int i = 0; i < 100; ++i) {
    const std::int64_t t = i * 20 * kMs;
    EXPECT_FALSE(fast.due_ns() && *fast.due_ns() < t) << "a pose comes first";
    (void)fast.add(tracked(t, SteadyFlight().at(0.02 * i)), t);
  }
  EXPECT_TRUE(fast.due_ns()) << "but when they stop coming, there are some";
}

TEST(MavlinkOdometry, ExtrapolationsAreAsWrongAsTheySay) {
  // A random walk of the acceleration: the error of extrapolations against their covariance.
  std::mt19937 random(3);
  std::normal_distribution<double> normal(0, 1);
  for (const bool turning : {false, true}) {
    OdometryStream stream({});
    const auto placement = plain_placement();
    std::vector<Pose> poses;
    Eigen::Vector3d p(0, 0, 0), v(2, 0, 0), a(0, 0, 0), w(0, 0, 0);
    Eigen::Quaterniond q = camera_mount(0, 0, 0);
    constexpr int kSteps = 10;  // of 5 ms between poses
    const auto step = [&] {
      constexpr double dt = 0.005;
      a = 0.95 * a + 1.0 * Eigen::Vector3d(normal(random), normal(random), normal(random));
      w = 0.95 * w + 0.1 * Eigen::Vector3d(normal(random), normal(random), normal(random));
      p += v * dt + 0.5 * a * dt * dt;
      v += a * dt;
      if (turning) q = q * so3_exp(w * dt);
      return Pose(q, p);
    };
    for (int i = 0; i < kSteps * 1500; ++i) poses.push_back(step());
    double error = 0, said = 0, turned = 0, said_turned = 0;
    for (int k = 0; k + 1 < 1500; ++k) {
      const std::int64_t t = k * 50 * kMs;
      PoseEvent event = tracked(t, poses[static_cast<std::size_t>(k) * kSteps], placement);
      event.covariance = 1e-12 * Matrix6d::Identity();
      (void)stream.add(event, t);
      if (k < 30 || !stream.due_ns()) continue;
      const auto m = stream.extrapolate(*stream.due_ns());  // after 25 ms
      ASSERT_TRUE(m);
      const auto at = static_cast<std::size_t>(m->time_usec / 5000);
      const BodyPose truth =
          body_pose(poses[at], event.covariance, *placement, OdometryOptions{}.T_body_camera);
      error += (position(*m) - truth.T_ned_body.translation()).squaredNorm();
      turned += std::pow(attitude(*m).angularDistance(truth.T_ned_body.rotation()), 2);
      said += full(m->pose_covariance).topLeftCorner<3, 3>().trace();
      said_turned += full(m->pose_covariance).bottomRightCorner<3, 3>().trace();
    }
    EXPECT_GT(said / error, 0.5);
    EXPECT_LT(said / error, 5);
    if (turning) {
      EXPECT_GT(said_turned / turned, 0.5);
      EXPECT_LT(said_turned / turned, 5);
    }
  }
}

}  // namespace
}  // namespace corvid
