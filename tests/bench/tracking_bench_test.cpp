#include "bench/tracking_bench.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <sstream>

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

constexpr int kFrames = 40;

/// A camera that moves 0.1 units to the right per frame past points at depth 10, in rows of the
/// image: 3 px per frame to the left, epipolar lines horizontal.
struct Pass {
  TrackingRun run;
  std::vector<std::optional<Pose>> poses;

  Pass() {
    run.set = "a pass";
    run.max_tracks = 100;
    run.camera = {CameraModel::pinhole, 320, 240, 300, 300, 160, 120, {}};
    for (int f = 0; f < kFrames; ++f) {
      TrackingRun::Step step;
      step.time_ns = f;
      step.wall_ms = f;  // median 19.5
      step.cpu_ms = 2;
      step.parts_ms = {{"frontend/pyramid", 1.0}};
      if (f % 2 == 0) step.parts_ms.emplace_back("frontend/corners", 4.0);
      run.frames.push_back(step);
      poses.emplace_back(Pose(Eigen::Quaterniond::Identity(), {0.1 * f, 0, 0}));
    }
  }
  /// Seen in frames [0, last]; `drift_px` per frame, downwards.
  void add(std::uint32_t id, double u, int last, double drift_px = 0) {
    for (int f = 0; f <= last; ++f) {
      TrackObservation o;
      o.track = TrackId(id);
      o.pixel = {u - 3.0 * f, 100 + drift_px * f};
      run.frames[static_cast<std::size_t>(f)].observations.push_back(o);
    }
  }
};

TEST(TrackingBench, ATrackThatLivesAndStaysHasNoDrift) {
  Pass pass;
  pass.add(0, 250, kFrames - 1);
  const TrackingRow row = score_tracking(pass.run, pass.poses);
  EXPECT_TRUE(row.has_truth);
  for (const TrackAge& age : {row.ages[0], row.ages[1]}) {
    EXPECT_EQ(age.born, 1);
    EXPECT_EQ(age.share_alive(), 1.0);
    EXPECT_NEAR(age.epipolar_px.value(), 0, 1e-6);
    EXPECT_NEAR(age.reprojection_px.value(), 0, 1e-6);
  }
  EXPECT_EQ(row.ages[2].born, 0) << "no frame is 60 frames after its birth";
  EXPECT_FALSE(row.ages[2].share_alive());
  EXPECT_FALSE(row.ages[2].epipolar_px);
}

TEST(TrackingBench, DriftIsMeasuredAcrossTheEpipolarLine) {
  Pass pass;
  pass.add(0, 250, kFrames - 1, 0.05);
  const TrackingRow row = score_tracking(pass.run, pass.poses);
  EXPECT_NEAR(row.ages[0].epipolar_px.value(), 0.5, 0.05);
  EXPECT_NEAR(row.ages[1].epipolar_px.value(), 1.5, 0.15);
  // The point lies in the middle of the drift of 1.95 px: 0.975 px from the first place.
  EXPECT_NEAR(row.ages[0].reprojection_px.value(), 0.475, 0.05);
}

TEST(TrackingBench, WhatLeftTheImageIsNotWhatWasLost) {
  Pass pass;
  pass.add(0, 250, kFrames - 1);  // lives
  pass.add(1, 250, 5);            // lost
  pass.add(2, 60, 12);            // left after 20 frames, seen until the 12th
  const TrackingRow row = score_tracking(pass.run, pass.poses);
  EXPECT_EQ(row.ages[0].born, 3);
  EXPECT_EQ(row.ages[0].alive, 2);
  EXPECT_EQ(row.ages[0].left, 0);
  EXPECT_EQ(row.ages[1].alive, 1);
  EXPECT_EQ(row.ages[1].left, 1);
  EXPECT_DOUBLE_EQ(row.ages[1].share_alive().value(), 1.0 / 3);
  EXPECT_DOUBLE_EQ(row.ages[1].share_alive_visible().value(), 0.5);
}

TEST(TrackingBench, WithoutTruthThereIsNoDrift) {
  Pass pass;
  pass.add(0, 250, kFrames - 1);
  const TrackingRow row = score_tracking(pass.run, {});
  EXPECT_FALSE(row.has_truth);
  EXPECT_EQ(row.ages[0].share_alive(), 1.0);
  EXPECT_FALSE(row.ages[0].epipolar_px);
  EXPECT_FALSE(row.ages[0].reprojection_px);
}

TEST(TrackingBench, TimesAndRows) {
  Pass pass;
  pass.add(0, 250, kFrames - 1);
  TrackingReport report;
  report.rows.push_back(score_tracking(pass.run, pass.poses));
  const json row = json::parse(json_rows(report)).at(0);
  EXPECT_EQ(row["set"], "a pass");
  EXPECT_DOUBLE_EQ(row["median_ms"], 19.5);
  EXPECT_DOUBLE_EQ(row["p95_ms"], 37);
  EXPECT_DOUBLE_EQ(row["cpu_ms"], 2);
  EXPECT_EQ(row["steps"][1]["name"], "frontend/corners");
  EXPECT_EQ(row["steps"][1]["runs"], 20);
  EXPECT_DOUBLE_EQ(row["steps"][1]["median_ms"], 4);
  EXPECT_DOUBLE_EQ(row["steps"][1]["mean_ms"], 2);
  EXPECT_EQ(row["ages"][0]["frames"], 10);
  EXPECT_TRUE(row["ages"][2]["share_alive"].is_null());
  std::ostringstream out;
  print(report, out);
  EXPECT_THAT(out.str(), HasSubstr("100.0 %"));
}

TEST(TrackingBench, AnEmptyRunIsARowOfNothing) {
  const TrackingRow row = score_tracking({}, {});
  EXPECT_EQ(row.frames, 0);
  EXPECT_FALSE(row.ages[0].share_alive());
  std::ostringstream out;
  print(TrackingReport{}, out);
  EXPECT_THAT(out.str(), HasSubstr("Nothing"));
}

}  // namespace
}  // namespace corvid
