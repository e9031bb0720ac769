// The measure of the hard cases: errors over what is claimed.
#include "scenes/honesty.h"

#include <gtest/gtest.h>

#include <random>

namespace corvid {
namespace {

/// A walk whose poses are off by what they claim, in a world of another scale and place.
struct Walk {
  Trajectory truth;
  std::vector<PoseEvent> events;
  std::map<int, StampedPose> origins;
};

Walk walk(double claimed_over_true, std::uint64_t seed, double scale_drift = 0) {
  constexpr double kScale = 0.25, kRho = 0.01, kPhi = 0.002;
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  const Pose T_world_origin(so3_exp({0.3, -0.2, 0.1}), Eigen::Vector3d(2, 1, -1));
  Walk w;
  for (int i = 0; i < 400; ++i) {
    const double t = 0.05 * i;
    const Pose real(so3_exp({0.1 * t, 0.2 * std::sin(t), 0}), Eigen::Vector3d(3 * t, 5, t * t / 8));
    w.truth.push_back({100'000'000LL * i, real});
    const Pose relative = w.truth.front().T_world_camera.inverse() * real;
    const double scale = kScale * (1 + scale_drift * i / 400);
    const Pose here = T_world_origin * Pose(relative.rotation(), scale * relative.translation());
    Vector6d error;
    for (int k = 0; k < 6; ++k) error[k] = normal(random) * (k < 3 ? kRho : kPhi);
    PoseEvent e;
    e.time_ns = w.truth.back().time_ns;
    e.state = TrackingState::tracking;
    e.T_world_camera = here * Pose::exp(error);
    e.covariance.diagonal().head<3>().setConstant(kRho * kRho);
    e.covariance.diagonal().tail<3>().setConstant(kPhi * kPhi);
    e.covariance *= claimed_over_true * claimed_over_true;
    w.events.push_back(e);
  }
  w.origins[0] = {0, T_world_origin};
  return w;
}

scenes::Honesty honesty(const Walk& w) {
  return scenes::summarise(scenes::compare_claims(w.events, w.truth, w.origins));
}

TEST(Honesty, ExactClaimsGiveChiSquare) {
  const scenes::Honesty h = honesty(walk(1, 1));
  EXPECT_EQ(h.poses, 400U);
  EXPECT_NEAR(h.median_squared, 5.35, 0.8);
  EXPECT_GT(h.within, 0.99);
  EXPECT_LT(h.worst, 5.5);
}

TEST(Honesty, ClaimsThatAreTooSmallAreSeen) {
  const scenes::Honesty h = honesty(walk(0.3, 2));
  EXPECT_NEAR(h.median_squared, 5.35 / 0.09, 8);
  EXPECT_LT(h.within, 0.1);
}

TEST(Honesty, AScaleThatDriftsIsSeenAndOneThatIsArbitraryIsNot) {
  EXPECT_GT(honesty(walk(1, 3, 0)).within, 0.99);
  EXPECT_LT(honesty(walk(1, 3, 0.05)).within, 0.8);
}

TEST(Honesty, NoCovarianceIsNoClaim) {
  Walk w = walk(1, 4);
  w.events[7].covariance.setZero();
  const scenes::Honesty h = honesty(w);
  EXPECT_EQ(h.worst, INFINITY);
  EXPECT_EQ(h.worst_event, 7U);
}

TEST(Honesty, EventsWithoutAPoseATruthOrAnOriginAreLeftOut) {
  Walk w = walk(1, 5);
  w.events[0].T_world_camera.reset();
  w.events[1].segment = 3;
  w.events[2].time_ns += 1'000'000'000'000;
  EXPECT_EQ(honesty(w).poses, 397U);
  EXPECT_EQ(scenes::summarise({}).poses, 0U);
}

}  // namespace
}  // namespace corvid
