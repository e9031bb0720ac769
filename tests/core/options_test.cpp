#include "corvid/options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

namespace corvid {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;

TEST(Options, DefaultsAreValid) { EXPECT_THAT(Options().validate(), IsEmpty()); }

TEST(Options, EveryProblemIsListedAtOnce) {
  Options options;
  options.frontend.max_tracks = 0;
  options.frontend.template_px = 10;
  options.backend.huber_px = 0;
  options.mapping.min_views = 9;
  options.device = "fastest";
  options.threads = -1;
  EXPECT_THAT(options.validate(),
              ElementsAre("frontend.max_tracks: must be from 50 to 100000, not 0",
                          "frontend.template_px: must be an odd number from 3 to 31, not 10",
                          "backend.huber_px: must be more than 0, not 0",
                          "mapping.min_views: must be at most mapping.neighbours (4), not 9",
                          "device: must be auto, cpu, gpu or a device's index, not \"fastest\"",
                          "threads: must be from 0 to 1024, not -1"));
}

TEST(Options, EachFieldIsChecked) {
  struct Fault {
    const char* field;
    std::function<void(Options&)> plant;
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  const Fault faults[] = {
      {"frontend.max_tracks", [](Options& o) { o.frontend.max_tracks = -5; }},
      {"frontend.corner_quality", [](Options& o) { o.frontend.corner_quality = 1.5; }},
      {"frontend.harris_kappa", [](Options& o) { o.frontend.harris_kappa = 0.3; }},
      {"frontend.template_px", [](Options& o) { o.frontend.template_px = 33; }},
      {"frontend.template_px", [](Options& o) { o.frontend.template_px = 1; }},
      {"frontend.min_score", [](Options& o) { o.frontend.min_score = 1.01; }},
      {"frontend.peak_quality", [](Options& o) { o.frontend.peak_quality = -0.1; }},
      {"frontend.ratio_highest_scores", [](Options& o) { o.frontend.ratio_highest_scores = 0.9; }},
      {"frontend.max_epipolar_px", [&](Options& o) { o.frontend.max_epipolar_px = nan; }},
      {"frontend.corner_score_ratio", [](Options& o) { o.frontend.corner_score_ratio = 0; }},
      {"frontend.keyframe_min_tracked", [](Options& o) { o.frontend.keyframe_min_tracked = 2; }},
      {"frontend.keyframe_parallax", [&](Options& o) { o.frontend.keyframe_parallax = nan; }},
      {"backend.start_min_parallax_rad", [](Options& o) { o.backend.start_min_parallax_rad = -1; }},
      {"backend.start_min_inliers", [](Options& o) { o.backend.start_min_inliers = 7; }},
      {"backend.max_error_px", [&](Options& o) { o.backend.max_error_px = inf; }},
      {"backend.min_angle_rad", [](Options& o) { o.backend.min_angle_rad = 2; }},
      {"backend.huber_px", [](Options& o) { o.backend.huber_px = -1; }},
      {"backend.window_keyframes", [](Options& o) { o.backend.window_keyframes = 1; }},
      {"backend.max_iterations", [](Options& o) { o.backend.max_iterations = 0; }},
      {"backend.min_inliers", [](Options& o) { o.backend.min_inliers = 3; }},
      {"mapping.neighbours", [](Options& o) { o.mapping.neighbours = 17; }},
      {"mapping.depth_samples", [](Options& o) { o.mapping.depth_samples = 1; }},
      {"mapping.depth_scale", [](Options& o) { o.mapping.depth_scale = -1; }},
      {"mapping.template_px", [](Options& o) { o.mapping.template_px = 12; }},
      {"mapping.min_score", [&](Options& o) { o.mapping.min_score = nan; }},
      {"mapping.min_views", [](Options& o) { o.mapping.min_views = 0; }},
      {"mapping.voxel_size", [](Options& o) { o.mapping.voxel_size = -0.1; }},
      {"mapping.voxel_size", [&](Options& o) { o.mapping.voxel_size = inf; }},
      {"mapping.memory_mb", [](Options& o) { o.mapping.memory_mb = 0; }},
      {"mapping.stream_bytes_per_s", [](Options& o) { o.mapping.stream_bytes_per_s = 0; }},
      {"mapping.disk_mb", [](Options& o) { o.mapping.disk_mb = -1; }},
      {"mapping.cut_voxel_size", [](Options& o) { o.mapping.cut_voxel_size = -1; }},
      {"mapping.cut_decay", [](Options& o) { o.mapping.cut_decay = 0; }},
      {"mapping.cut_ballooning", [](Options& o) { o.mapping.cut_ballooning = 1.5; }},
      {"mapping.cut_max_mb", [](Options& o) { o.mapping.cut_max_mb = 0; }},
      {"device", [](Options& o) { o.device = ""; }},
      {"device", [](Options& o) { o.device = "-1"; }},
      {"threads", [](Options& o) { o.threads = 5000; }},
  };
  for (const Fault& fault : faults) {
    Options options;
    fault.plant(options);
    const auto problems = options.validate();
    ASSERT_EQ(problems.size(), 1u) << fault.field;
    EXPECT_THAT(problems[0], StartsWith(std::string(fault.field) + ": "));
  }
}

TEST(Options, DeviceMayBeAnIndex) {
  Options options;
  for (const char* device : {"auto", "cpu", "gpu", "0", "12"}) {
    options.device = device;
    EXPECT_THAT(options.validate(), IsEmpty()) << device;
  }
}

}  // namespace
}  // namespace corvid
