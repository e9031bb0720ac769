// How well the cameras of real recordings are found, end to end, without mapping. The limits are
// what the engine is meant to reach, not what it happens to reach (docs/results.md has those).
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <iostream>
#include <map>
#include <optional>

#include "apps/evaluation.h"
#include "apps/report_numbers.h"
#include "corvid/engine.h"
#include "io/source.h"

namespace corvid {
namespace {

struct Flown {
  RunResult result;
  RunNumbers numbers;
  Trajectory truth;
};

/// Nothing where the set is not on this machine.
std::optional<Flown> fly(const std::string& name) {
  const auto folder = std::filesystem::path(CORVID_SOURCE_DIR) / ".." / "shared" / "data" / name;
  if (!std::filesystem::exists(folder)) return std::nullopt;
  auto source = open_source(folder.string());
  if (!source) throw std::runtime_error(source.error().to_string());
  Options options;
  options.mapping.enabled = false;
  auto engine = Engine::create(options);
  if (!engine) throw std::runtime_error(engine.error().to_string());
  auto result = (*engine)->run(**source);
  if (!result) throw std::runtime_error(result.error().to_string());
  const RunNumbers numbers = count_run(*result);
  return Flown{std::move(*result), numbers, (*source)->truth()};
}

#define FLY_OR_SKIP(flown, name) \
  const auto flown = fly(name);  \
  if (!flown) GTEST_SKIP() << "the real image sets (../shared/data) are absent: " << (name)

struct Accuracy {
  double ate_m = 0, orientation_deg = 0, share_of_length = 0;
};

Accuracy accuracy_of(const Flown& flown) {
  const TrajectoryErrors errors = evaluate(flown.result.trajectory, flown.truth);
  EXPECT_EQ(errors.problem, "");
  std::cout << "  ATE " << errors.position_m.rmse << " m over " << errors.path_length_m << " m, "
            << errors.orientation_deg.rmse << " degrees, " << flown.numbers.poses << " poses, "
            << flown.numbers.untracked_after_start << " untracked after the start, "
            << flown.numbers.segments << " segments\n";
  EXPECT_EQ(errors.matched, flown.result.trajectory.size());
  return {errors.position_m.rmse, errors.orientation_deg.rmse,
          errors.position_m.rmse / errors.path_length_m};
}

TEST(Accuracy, Euroc) {
  FLY_OR_SKIP(flown, "euroc_mh05_a");
  const Accuracy a = accuracy_of(*flown);
  EXPECT_LE(a.ate_m, 0.018);
  EXPECT_LE(a.orientation_deg, 0.5);
  EXPECT_EQ(flown->numbers.untracked_after_start, 0U);
  EXPECT_GE(flown->numbers.poses, 285U) << "it starts within the first frames";
}

TEST(Accuracy, Kitti) {
  FLY_OR_SKIP(flown, "kitti07");
  const Accuracy a = accuracy_of(*flown);
  EXPECT_LE(a.ate_m, 0.2);
  EXPECT_LE(a.orientation_deg, 0.5);
  EXPECT_EQ(flown->numbers.untracked_after_start, 0U);
  EXPECT_GE(flown->numbers.poses, 150U);
}

TEST(Accuracy, APlane) {
  FLY_OR_SKIP(flown, "vamr1_checker");
  EXPECT_LE(accuracy_of(*flown).share_of_length, 0.005);
  EXPECT_EQ(flown->numbers.untracked_after_start, 0U);
}

TEST(Accuracy, AerialPhotographsWithNothingButTheirExif) {
  FLY_OR_SKIP(flown, "aerial_caliterra_a");
  EXPECT_EQ(flown->result.source.intrinsics, IntrinsicsOrigin::exif);
  std::map<int, int> images;  // by segment; every photograph with a pose is a keyframe
  for (const auto& keyframe : flown->result.map->keyframes) ++images[keyframe->segment];
  int most = 0;
  for (const auto& [segment, count] : images) most = std::max(most, count);
  std::cout << "  " << most << " of " << flown->numbers.delivered << " images in one segment of "
            << images.size() << "\n";
  EXPECT_EQ(flown->numbers.delivered, 45U);
  EXPECT_GE(most, 40);
}

}  // namespace
}  // namespace corvid
