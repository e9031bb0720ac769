#include "bench/mapping_bench.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <sstream>

#include "scenes/ball_views.h"
#include "scenes/plane_views.h"

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

/// A slanted wall, seen by cameras side by side.
MappingScene wall(int views) {
  testing::PlaneScene scene;
  scene.planes = {{Eigen::Vector3d(0.2, -0.1, 1).normalized(), 4}};
  scene.finest = 0.07;
  const auto camera = std::make_shared<const Camera>(testing::pinhole(160, 120, 130));
  MappingScene out;
  out.name = "wall";
  for (int i = 0; i < views; ++i) {
    const Pose T(Eigen::Quaterniond::Identity(), {0.15 * i, 0.02 * (i % 2), 0});
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(i));
    frame->grey = scene.render(*camera, T);
    frame->camera = camera;
    out.views.push_back({frame, T, scene.depth(*camera, T)});
  }
  return out;
}

std::shared_ptr<const DepthMap> depth_map(const MappingScene& scene, float factor) {
  auto map = std::make_shared<DepthMap>();
  map->keyframe = KeyframeId(1);
  map->camera = *scene.views[1].frame->camera;
  map->depth = scene.views[1].depth;
  for (std::size_t i = 0; i < map->depth.size(); ++i) {
    map->depth.data()[i] *= i % 4 == 0 ? 0 : factor;  // a quarter without an answer
  }
  return map;
}

TEST(MappingBench, DepthIsScoredAgainstTruth) {
  const MappingScene scene = wall(3);
  const DepthScore exact = score_depth(scene, {depth_map(scene, 1)});
  EXPECT_NEAR(exact.answered.value(), 0.75, 0.01);
  EXPECT_EQ(exact.within_1, 1);
  EXPECT_NEAR(exact.median_error_m.value(), 0, 1e-6);
  const DepthScore off = score_depth(scene, {depth_map(scene, 1.015F)});
  EXPECT_EQ(off.within_1, 0);
  EXPECT_EQ(off.within_2, 1);
  EXPECT_GT(off.median_error_m.value(), 0.03);
  EXPECT_FALSE(score_depth(scene, {}).answered.has_value());
  const DepthScore none = score_depth(scene, {depth_map(scene, 0)});
  EXPECT_EQ(none.answered, 0);
  EXPECT_FALSE(none.within_1 || none.within_2 || none.median_error_m);
}

TEST(MappingBench, AScoreIsOfTheWholeMapOrNone) {
  const auto device = Device::open("auto").value();
  const auto row = score_mapping(device, wall(5), {});
  ASSERT_TRUE(row.has_value() && row->has_value());
  EXPECT_EQ((*row)->views, 5);
  EXPECT_GT((*row)->within_2.value(), 0.9);
  std::stop_source stop;
  stop.request_stop();
  const auto stopped = score_mapping(device, wall(5), stop.get_token());
  ASSERT_TRUE(stopped.has_value());
  EXPECT_FALSE(stopped->has_value());
}

TEST(MappingBench, TheTrueMapIsSeenByTheViewsThatSeeIt) {
  const MapSnapshot map = true_map(wall(5));
  ASSERT_EQ(map.keyframes.size(), 5U);
  ASSERT_GT(map.landmarks.size(), 500U);
  for (const auto& keyframe : map.keyframes) {
    ASSERT_GT(keyframe->observations.size(), 300U);
    for (const Observation& o : keyframe->observations) {
      const auto pixel =
          map.camera->project(keyframe->T_world_camera.inverse() * map.find(o.landmark)->p_world);
      EXPECT_LT((*pixel - o.pixel).norm(), 1e-9);
    }
  }
  EXPECT_TRUE(true_map({}).keyframes.empty());
}

TEST(MappingBench, PixelsAndRaysThroughAVolumeAreTimed) {
  const auto device = Device::open("auto").value();
  auto peak = PeakMeter::create(device).value();
  const MappingScene scene = wall(6);
  Eigen::AlignedBox3d volume(Eigen::Vector3d(-0.6, -0.6, 3), Eigen::Vector3d(1.2, 0.6, 4.6));
  MappingReport report;
  const auto done = time_depth(
      device, peak, {{"pixels", &scene, 2, {}, 0, 48}, {"rays", &scene, 2, volume, 5000, 0}}, 1, {},
      report);
  ASSERT_TRUE(done.has_value()) << done.error().to_string();
  ASSERT_EQ(report.rows.size(), 2U);
  EXPECT_EQ(report.rows[0].rays, 160 * 120);
  EXPECT_EQ(report.rows[0].depths, 48);
  EXPECT_NEAR(report.rows[1].rays.value(), 5000, 100);
  for (const MappingRow& row : report.rows) {
    EXPECT_GT(row.answered.value(), 0.7) << row.workload;
    EXPECT_GT(row.share_of_peak.value(), 0);
    EXPECT_GT(row.seconds.value(), 0);
  }
}

TEST(MappingBench, AVolumeThatNobodySeesIsAnError) {
  const auto device = Device::open("auto").value();
  auto peak = PeakMeter::create(device).value();
  const MappingScene scene = wall(6);
  const Eigen::AlignedBox3d behind(Eigen::Vector3d(-1, -1, -5), Eigen::Vector3d(1, 1, -4));
  MappingReport report;
  EXPECT_FALSE(time_depth(device, peak, {{"behind", &scene, 2, behind, 5000, 0}}, 1, {}, report));
  const MappingScene few = wall(3);
  EXPECT_FALSE(time_depth(device, peak, {{"few", &few, 1, {}, 0, 48}}, 1, {}, report));
  MappingScene bent = scene;
  Camera lens = *scene.views[0].frame->camera;
  lens.model = CameraModel::radtan;
  lens.distortion = {-0.2, 0.05, 0, 0, 0};
  for (TrueView& view : bent.views) {
    auto frame = std::make_shared<Frame>(*view.frame);
    frame->camera = std::make_shared<const Camera>(lens);
    view.frame = frame;
  }
  const auto refused = time_depth(device, peak, {{"bent", &bent, 2, {}, 0, 48}}, 1, {}, report);
  ASSERT_FALSE(refused.has_value());
  EXPECT_THAT(refused.error().to_string(), HasSubstr("distorted"));
}

TEST(MappingBench, SnapshotsAreTimedAndFoundClosed) {
  const auto device = Device::open("auto").value();
  MappingScene scene;
  scene.name = "ball";
  for (const StillView& view : testing::ball_views(7)) {
    scene.views.push_back({view.frame, view.T_world_camera, {}});
  }
  scene.views.push_back(scene.views[3]);  // looks away: no depth map
  scene.views.back().T_world_camera =
      scene.views[3].T_world_camera * Pose(so3_exp({0, 3.1, 0}), Eigen::Vector3d::Zero());
  const Eigen::AlignedBox3d volume(Eigen::Vector3d(-0.9, -0.9, 2.1), Eigen::Vector3d(0.9, 0.9, 3));
  MappingReport report;
  const auto done = time_snapshots(device, scene, volume, {3e4, 2e5}, 1, {}, report);
  ASSERT_TRUE(done.has_value()) << done.error().to_string();
  ASSERT_EQ(report.rows.size(), 2U);
  EXPECT_NEAR(report.rows[0].voxels.value(), 3e4, 3e3);
  EXPECT_NEAR(report.rows[1].voxels.value(), 2e5, 1e4);
  for (const MappingRow& row : report.rows) {
    EXPECT_EQ(row.views, 7);
    EXPECT_GT(row.graph_s.value(), 0);
    EXPECT_GT(row.maxflow_s.value(), 0);
    EXPECT_GT(row.peak_mb.value(), 0);
    EXPECT_EQ(row.unpaired_sides.value(), 0);
  }
  EXPECT_FALSE(time_snapshots(device, wall(6), volume, {3e4}, 1, {}, report));
}

TEST(MappingBench, RowsHaveEveryKeyAndNullsForWhatDoesNotApply) {
  MappingReport report;
  std::ostringstream empty;
  print(report, empty);
  EXPECT_THAT(empty.str(), HasSubstr("Nothing was measured"));
  MappingRow row;
  row.workload = "live";
  row.rays = 307200;
  row.seconds = 0.25;
  report.rows.push_back(row);
  const json rows = json::parse(json_rows(report));
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0]["rays"], 307200);
  for (const char* key : {"workload", "views", "depths", "share_of_peak", "voxels", "graph_s",
                          "maxflow_s", "peak_mb"}) {
    ASSERT_TRUE(rows[0].contains(key)) << key;
  }
  EXPECT_TRUE(rows[0]["voxels"].is_null());
  std::ostringstream text;
  print(report, text);
  EXPECT_THAT(text.str(), HasSubstr("0.250"));
}

}  // namespace
}  // namespace corvid
