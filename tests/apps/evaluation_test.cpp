#include "apps/evaluation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

namespace corvid {
namespace {

using testing::HasSubstr;
constexpr double kRadPerDeg = std::numbers::pi / 180;
constexpr std::int64_t kMs = 1'000'000;

Eigen::Quaterniond yaw(double deg) { return so3_exp({0, 0, deg * kRadPerDeg}); }

/// A curved flight, `rate_hz` poses per second.
Pose flight(double t) {
  return {so3_exp({0.1 * std::sin(t), 0.2 * std::cos(0.7 * t), 0.3 * t}),
          {5 * std::sin(0.5 * t), 4 * std::cos(0.4 * t), std::sin(0.9 * t)}};
}
Trajectory curved(int n, double rate_hz = 10, double offset_s = 0) {
  Trajectory out;
  for (int i = 0; i < n; ++i) {
    const double t = i / rate_hz + offset_s;
    out.push_back({std::llround(t * 1e9), flight(t)});
  }
  return out;
}
/// Along x, one metre and `yaw_deg` per pose, ten poses per second; `stretch` times as long.
Trajectory straight(int n, double stretch = 1, double yaw_deg = 0) {
  Trajectory out;
  for (int i = 0; i < n; ++i) {
    out.push_back({i * 100 * kMs, Pose(yaw(yaw_deg * i), Eigen::Vector3d(stretch * i, 0, 0))});
  }
  return out;
}
Trajectory moved(const Sim3& T, Trajectory trajectory) {
  for (auto& p : trajectory) p.T_world_camera = T * p.T_world_camera;
  return trajectory;
}
EvaluationOptions mode(AlignmentMode alignment) {
  EvaluationOptions options;
  options.alignment = alignment;
  return options;
}
bool has_note(const TrajectoryErrors& e, const char* part) {
  for (const auto& note : e.notes) {
    if (note.find(part) != std::string::npos) return true;
  }
  return false;
}
void expect_finite(const TrajectoryErrors& e) {
  for (const Statistics& s :
       {e.position_m, e.orientation_deg, e.rpe_translation_m, e.rpe_rotation_deg}) {
    for (const double v : {s.rmse, s.mean, s.median, s.p90, s.max}) EXPECT_TRUE(std::isfinite(v));
  }
  EXPECT_TRUE(std::isfinite(e.scale) && std::isfinite(e.kitti.t_rel_percent) &&
              std::isfinite(e.kitti.r_rel_deg_per_100m) && std::isfinite(e.path_length_m));
  EXPECT_TRUE(std::isfinite(e.scale_drift.value_or(1)));
}

TEST(Statistics, OfKnownValues) {
  const Statistics s = statistics({4, 1, 3, 2});
  EXPECT_EQ(s.count, 4u);
  EXPECT_DOUBLE_EQ(s.mean, 2.5);
  EXPECT_DOUBLE_EQ(s.median, 2.5);
  EXPECT_DOUBLE_EQ(s.rmse, std::sqrt(7.5));
  EXPECT_DOUBLE_EQ(s.p90, 4);
  EXPECT_DOUBLE_EQ(s.max, 4);
  EXPECT_DOUBLE_EQ(statistics({1, 2, 3, 4, 5, 6, 7, 8, 9, 10}).p90, 9);
  EXPECT_DOUBLE_EQ(statistics({5, 1, 9}).median, 5);
  EXPECT_EQ(statistics({}).count, 0u);
}

TEST(Evaluate, FindsThePlantedSimilarity) {
  const Trajectory truth = curved(200);
  const Sim3 T(2.5, so3_exp({0.4, -1, 2}), {10, -20, 30});
  const TrajectoryErrors e = evaluate(moved(T.inverse(), truth), truth);
  EXPECT_EQ(e.problem, "");
  EXPECT_EQ(e.matched, 200u);
  EXPECT_EQ(e.unmatched, 0u);
  EXPECT_EQ(e.interpolated, 0u);
  EXPECT_NEAR(e.scale, 2.5, 1e-9);
  EXPECT_LT((e.T_truth_estimate * T.inverse()).log().norm(), 1e-9);
  EXPECT_LT(e.position_m.max, 1e-9);
  EXPECT_LT(e.orientation_deg.max, 1e-6);
  EXPECT_LT(e.rpe_translation_m.max, 1e-9);
  EXPECT_LT(e.kitti.t_rel_percent, 1e-6);
  ASSERT_TRUE(e.scale_drift);
  EXPECT_NEAR(*e.scale_drift, 1, 1e-9);
  EXPECT_EQ(e.poses.size(), 200u);
  EXPECT_EQ(e.position_errors_m.size(), 200u);
  EXPECT_EQ(e.orientation_errors_deg.size(), 200u);
}

TEST(Evaluate, RigidAlignmentShowsAScaleError) {
  const Trajectory truth = curved(200);
  const Sim3 T(0.5, so3_exp({0.4, -1, 2}), {10, -20, 30});
  const Trajectory estimate = moved(T, truth);
  const TrajectoryErrors rigid = evaluate(estimate, truth, mode(AlignmentMode::se3));
  EXPECT_EQ(rigid.T_truth_estimate.scale(), 1);
  EXPECT_NEAR(rigid.scale, 2, 1e-9);
  EXPECT_GT(rigid.position_m.rmse, 1);
  EXPECT_LT(rigid.orientation_deg.max, 1e-6);
  const TrajectoryErrors none = evaluate(estimate, truth, mode(AlignmentMode::none));
  EXPECT_GT(none.position_m.rmse, 20);
  EXPECT_EQ(none.T_truth_estimate.log().norm(), 0);
}

TEST(Evaluate, KnownOffsets) {
  const Trajectory truth = curved(100);
  Trajectory estimate = truth;
  for (auto& p : estimate) {
    p.T_world_camera = Pose(p.T_world_camera.rotation() * yaw(2),
                            p.T_world_camera.translation() + Eigen::Vector3d(0.3, -0.4, 0));
  }
  const TrajectoryErrors e = evaluate(estimate, truth, mode(AlignmentMode::none));
  EXPECT_NEAR(e.position_m.rmse, 0.5, 1e-12);
  EXPECT_NEAR(e.position_m.median, 0.5, 1e-12);
  EXPECT_NEAR(e.position_m.max, 0.5, 1e-12);
  EXPECT_NEAR(e.orientation_deg.rmse, 2, 1e-9);
  EXPECT_FALSE(has_note(e, "body frame"));
  // Alignment takes the offset away, but not what the cameras are turned by.
  const TrajectoryErrors aligned = evaluate(estimate, truth, mode(AlignmentMode::se3));
  EXPECT_LT(aligned.position_m.max, 1e-9);
  EXPECT_NEAR(aligned.orientation_deg.rmse, 2, 1e-6);
}

TEST(Evaluate, NotesThatTheTruthIsOfAnotherBodyFrame) {
  const Trajectory truth = curved(100);
  Trajectory estimate = truth;
  for (auto& p : estimate) {
    p.T_world_camera = Pose(p.T_world_camera.rotation() * yaw(90), p.T_world_camera.translation());
  }
  const TrajectoryErrors e = evaluate(estimate, truth);
  EXPECT_NEAR(e.orientation_deg.rmse, 90, 1e-6);
  EXPECT_TRUE(has_note(e, "constant 90.0 deg"));
}

TEST(Evaluate, TellsAConstantRotationFromTheRest) {
  const Trajectory truth = curved(100);
  Trajectory estimate = truth;
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    Pose& T = estimate[i].T_world_camera;
    T = Pose(T.rotation() * yaw(i % 2 == 0 ? 1.3 : 0.7), T.translation());
  }
  const TrajectoryErrors e = evaluate(estimate, truth);
  EXPECT_NEAR(e.orientation_deg.rmse, std::sqrt(1.09), 1e-6);
  EXPECT_NEAR(e.orientation_constant_deg, 1, 1e-6);
  EXPECT_NEAR(e.orientation_rest_deg, 0.3, 1e-6);
  EXPECT_FALSE(has_note(e, "constant"));
}

TEST(Evaluate, KnownRelativeErrors) {
  const TrajectoryErrors e =
      evaluate(straight(50, 1.01, 0.1), straight(50), mode(AlignmentMode::none));
  EXPECT_EQ(e.rpe_translation_m.count, 49u);
  EXPECT_NEAR(e.rpe_rotation_deg.rmse, 0.1, 1e-9);
  EvaluationOptions five = mode(AlignmentMode::none);
  five.rpe_delta_frames = 5;
  const TrajectoryErrors e5 = evaluate(straight(50, 1.01), straight(50), five);
  EXPECT_EQ(e5.rpe_translation_m.count, 45u);
  EXPECT_NEAR(e5.rpe_translation_m.rmse, 0.05, 1e-9);
  EXPECT_NEAR(e5.rpe_translation_m.max, 0.05, 1e-9);
}

TEST(Evaluate, RelativeErrorsDoNotSpanGaps) {
  Trajectory estimate = straight(50, 1.01);
  estimate.erase(estimate.begin() + 20, estimate.begin() + 30);
  const TrajectoryErrors e = evaluate(estimate, straight(50), mode(AlignmentMode::none));
  EXPECT_EQ(e.rpe_translation_m.count, 38u);
  EXPECT_NEAR(e.rpe_translation_m.max, 0.01, 1e-9);
  EXPECT_TRUE(has_note(e, "1 of 39"));
}

TEST(Evaluate, KittiSegments) {
  const TrajectoryErrors e =
      evaluate(straight(1001, 1.01), straight(1001), mode(AlignmentMode::none));
  EXPECT_FALSE(e.kitti.short_segments);
  EXPECT_THAT(e.kitti.lengths_m, testing::ElementsAre(100, 200, 300, 400, 500, 600, 700, 800));
  // A segment ends at the first pose beyond its length: L + 1 poses of one metre. From every tenth
  // pose, segments of L metres start at 0 ... 1000 - (L + 1).
  double sum = 0, count = 0;
  for (int length = 100; length <= 800; length += 100) {
    const double n = std::floor((1000 - (length + 1)) / 10.0) + 1;
    sum += n * 0.01 * (length + 1) / length;
    count += n;
  }
  EXPECT_EQ(static_cast<double>(e.kitti.segments), count);
  EXPECT_NEAR(e.kitti.t_rel_percent, 100 * sum / count, 1e-9);
  EXPECT_NEAR(e.kitti.r_rel_deg_per_100m, 0, 1e-6);
  EXPECT_NEAR(e.path_length_m, 1000, 1e-9);

  const TrajectoryErrors turned =
      evaluate(straight(1001, 1, 0.01), straight(1001), mode(AlignmentMode::none));
  EXPECT_NEAR(turned.kitti.r_rel_deg_per_100m, 1, 0.01);
}

TEST(Evaluate, ShortPathsHaveShortSegments) {
  const TrajectoryErrors e = evaluate(straight(46, 1.02), straight(46), mode(AlignmentMode::none));
  EXPECT_TRUE(e.kitti.short_segments);
  EXPECT_THAT(e.kitti.lengths_m, testing::ElementsAre(10, 20, 30, 40));
  EXPECT_NEAR(e.kitti.t_rel_percent, 2, 0.2);
  EXPECT_TRUE(has_note(e, "10 to 80 m"));
  const TrajectoryErrors tiny = evaluate(straight(6), straight(6), mode(AlignmentMode::none));
  EXPECT_EQ(tiny.kitti.segments, 0u);
  EXPECT_FALSE(tiny.kitti.short_segments);
  EXPECT_TRUE(has_note(tiny, "too short for t_rel"));
}

TEST(Evaluate, ScaleDrift) {
  const Trajectory truth = straight(90);
  Trajectory estimate;
  double x = 0;
  for (int i = 0; i < 90; ++i) {
    estimate.push_back({truth[static_cast<std::size_t>(i)].time_ns,
                        Pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(x, 0, 0))});
    x += i < 45 ? 1 : 0.8;
  }
  const TrajectoryErrors e = evaluate(estimate, truth, mode(AlignmentMode::none));
  ASSERT_TRUE(e.scale_drift);
  EXPECT_NEAR(*e.scale_drift, 1.25, 1e-9);
  EXPECT_FALSE(evaluate(straight(8), straight(8), mode(AlignmentMode::none)).scale_drift);
  Trajectory standing = straight(90);
  for (auto& p : standing) p.T_world_camera = {};
  EXPECT_FALSE(evaluate(standing, standing, mode(AlignmentMode::none)).scale_drift);
}

TEST(Evaluate, InterpolatedTruthIsNearlyExact) {
  const TrajectoryErrors e = evaluate(curved(100, 20, 0.0021), curved(1100, 200));
  EXPECT_EQ(e.matched, 100u);
  EXPECT_EQ(e.interpolated, 100u);
  EXPECT_LT(e.position_m.max, 1e-4);  // chord against arc over 5 ms
}

TEST(Evaluate, CountsWhatHasNoTruth) {
  const TrajectoryErrors e = evaluate(curved(100), curved(60));
  EXPECT_EQ(e.matched, 60u);
  EXPECT_EQ(e.unmatched, 40u);
  EXPECT_EQ(e.poses.back().estimate_index, 59u);
}

TEST(Evaluate, RefusesWithAReason) {
  EXPECT_THAT(evaluate({}, curved(5)).problem, HasSubstr("estimate has no poses"));
  EXPECT_THAT(evaluate(curved(5), {}).problem, HasSubstr("truth has no poses"));
  EXPECT_THAT(evaluate(curved(5, 10, 1000), curved(5)).problem, HasSubstr("same clock"));
  EXPECT_THAT(evaluate(straight(50, 1.01), straight(50)).problem, HasSubstr("one line"));
  EXPECT_THAT(evaluate(curved(2), curved(2)).problem, HasSubstr("fewer than three"));
}

TEST(Evaluate, NeverSaysNan) {
  Trajectory broken = curved(20);
  broken[7].T_world_camera = Pose(Eigen::Quaterniond::Identity(),
                                  Eigen::Vector3d(0, std::numeric_limits<double>::quiet_NaN(), 0));
  Trajectory standing = curved(20);
  for (auto& p : standing) p.T_world_camera = {};
  const Trajectory all[] = {{}, curved(1), curved(2), curved(20), broken, standing, straight(20)};
  for (const Trajectory& estimate : all) {
    for (const Trajectory& truth : all) {
      for (const AlignmentMode m : {AlignmentMode::sim3, AlignmentMode::se3, AlignmentMode::none}) {
        const TrajectoryErrors e = evaluate(estimate, truth, mode(m));
        expect_finite(e);
        EXPECT_EQ(e.matched + e.unmatched, estimate.size());
      }
    }
  }
  EXPECT_EQ(evaluate(broken, curved(20)).matched, 19u);
}

}  // namespace
}  // namespace corvid
