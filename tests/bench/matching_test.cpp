#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <set>

#include "bench/matching/corvid_side.h"
#include "bench/matching/epipolar_truth.h"
#include "bench/matching/matching_bench.h"
#include "bench/matching/reconstruction.h"
#include "bench/matching/sift_side.h"
#include "bench/matching/tally.h"
#include "frontend/epipolar.h"
#include "replay/synthetic_flight.h"
#include "scenes/flight_of.h"

namespace corvid {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::Pair;

Camera camera(double distortion = 0) {
  Camera c;
  c.width_px = 640;
  c.height_px = 480;
  c.fx_px = c.fy_px = 500;
  c.cx_px = 320;
  c.cy_px = 240;
  if (distortion != 0) {
    c.model = CameraModel::radtan;
    c.distortion[0] = distortion;
  }
  return c;
}

/// Cameras side by side that look at points 4 to 8 m away, and exact or noisy matches of them.
struct Scene {
  explicit Scene(int images, double noise_px = 0, int count = 2000, const Camera& c = camera()) {
    std::mt19937 random(7);
    std::normal_distribution<double> noise(0, noise_px > 0 ? noise_px : 1);
    std::uniform_real_distribution<double> side(-1, 1), depth(4, 8);
    for (int i = 0; i < images; ++i) {
      auto frame = std::make_shared<Frame>();
      frame->id = FrameId(static_cast<std::uint32_t>(i));
      frame->time_ns = i * 100'000'000LL;
      frame->camera = std::make_shared<const Camera>(c);
      frames.push_back(frame);
      poses.emplace_back(
          Pose(so3_exp({0.01 * i, -0.02 * i, 0.05 * i}), {0.4 * i, 0.05 * i, 0.1 * i}));
    }
    while (static_cast<int>(pixels.size()) < count) {
      const Eigen::Vector3d p(2.2 * side(random), 1.6 * side(random), depth(random));
      std::vector<Eigen::Vector2d> seen;
      for (const auto& T : poses) {
        const auto pixel = c.project(T->inverse() * p);
        if (!pixel || !c.in_image(*pixel)) break;
        seen.push_back(*pixel);
        if (noise_px > 0) seen.back() += Eigen::Vector2d(noise(random), noise(random));
      }
      if (seen.size() == poses.size()) pixels.push_back(seen);
    }
  }
  [[nodiscard]] MatchedPair pair(int r, int t) const {
    MatchedPair matched{r, t, {}, 1};
    for (std::size_t k = 0; k < pixels.size(); ++k) {
      const int name = static_cast<int>(k);
      matched.matches.push_back({name, name, pixels[k][static_cast<std::size_t>(r)],
                                 pixels[k][static_cast<std::size_t>(t)]});
    }
    return matched;
  }
  std::vector<FramePtr> frames;
  std::vector<std::optional<Pose>> poses;
  std::vector<std::vector<Eigen::Vector2d>> pixels;  // of each point, in each image
};

TEST(ChooseRuns, VideosGiveRunsOfThreeSpreadOverTheirLength) {
  EXPECT_THAT(choose_runs(100, false, 9), ElementsAre(Pair(0, 3), Pair(48, 3), Pair(97, 3)));
  EXPECT_THAT(choose_runs(7, false, 30), ElementsAre(Pair(0, 3), Pair(4, 3))) << "no overlap";
  EXPECT_THAT(choose_runs(100, false, 3), ElementsAre(Pair(0, 3)));
  EXPECT_THAT(choose_runs(2, false, 30), ElementsAre(Pair(0, 2)));
  EXPECT_THAT(choose_runs(std::nullopt, false, 6), ElementsAre(Pair(0, 3), Pair(3, 3)));
}

TEST(ChooseRuns, StillsGiveTheFirstImages) {
  EXPECT_THAT(choose_runs(45, true, 17), ElementsAre(Pair(0, 10))) << "9 and 8 pairs";
  EXPECT_THAT(choose_runs(45, true, 18), ElementsAre(Pair(0, 10))) << "11 images have 19";
  EXPECT_THAT(choose_runs(5, true, 30), ElementsAre(Pair(0, 5)));
  EXPECT_THAT(choose_runs(1, true, 30), IsEmpty());
}

TEST(EpipolarTruth, ExactMatchesLieOnTheirLinesThroughALens) {
  const Scene scene(2, 0, 300, camera(-0.2));
  const auto F = true_fundamental(*scene.frames[0]->camera, *scene.poses[0], *scene.poses[1]);
  ASSERT_TRUE(F);
  for (const double d :
       epipolar_distances_px(*scene.frames[0]->camera, *F, scene.pair(0, 1).matches))
    EXPECT_LT(d, 1e-6);
}

TEST(EpipolarTruth, AMoveAcrossTheLineIsTheDistance) {
  const Camera c = camera();
  const Scene scene(2);
  const auto F = true_fundamental(c, *scene.poses[0], *scene.poses[1]);
  MatchedPair pair = scene.pair(0, 1);
  for (std::size_t k = 0; k < pair.matches.size(); ++k) {
    Correspondence& m = pair.matches[k];
    const Eigen::Vector2d normal = (*F * m.x_r.homogeneous()).head<2>().normalized();
    const Eigen::Vector2d along(-normal.y(), normal.x());
    m.x_t += (k % 50 == 0 ? 3.5 : 0.25) * normal + 7 * along;  // one in fifty is wrong
  }
  for (const double d : epipolar_distances_px(c, *F, {&pair.matches[1], 1}))
    EXPECT_NEAR(d, 0.25, 1e-9);
  Tally tally;
  tally.add(c, pair, F);
  EXPECT_NEAR(*tally.figures().all.truth_px, 0.25, 1e-9);
  EXPECT_DOUBLE_EQ(*tally.figures().all.wrong_percent, 2);
  EXPECT_EQ(tally.figures().gap2.pairs, 0);
  EXPECT_FALSE(tally.figures().gap2.truth_px);
}

TEST(EpipolarTruth, CamerasInOnePlaceHaveNone) {
  const Pose T(so3_exp({0, 0, 1}), {1, 2, 3});
  EXPECT_FALSE(true_fundamental(camera(), T, T));
  EXPECT_FALSE(true_fundamental(camera(), T, Pose(T.rotation(), {1, 2, 3.009})));
}

// Two images leave one residual of four numbers per point, across the epipolar line; three leave
// three of six, and each point is in two of the three pairs.
TEST(Reconstruct, TheErrorFollowsFromTheNoise) {
  constexpr double kSigma_px = 0.3;
  const Scene two(2, kSigma_px);
  const MatchedPair one_pair[] = {two.pair(0, 1)};
  const Reconstruction r2 =
      reconstruct(two.frames, two.poses, one_pair, IntrinsicsOrigin::calibration);
  EXPECT_EQ(r2.images, 2);
  EXPECT_EQ(r2.correspondences, r2.points);
  EXPECT_GE(r2.points, 1990) << "few are over 3 px";
  ASSERT_TRUE(r2.mse_px2());
  EXPECT_NEAR(*r2.mse_px2(), kSigma_px * kSigma_px, 0.06 * kSigma_px * kSigma_px);

  const Scene three(3, kSigma_px);
  const MatchedPair pairs[] = {three.pair(0, 1), three.pair(0, 2), three.pair(1, 2)};
  const Reconstruction r3 =
      reconstruct(three.frames, three.poses, pairs, IntrinsicsOrigin::calibration);
  EXPECT_EQ(r3.point_images, 3 * r3.points) << "matches of one name are one track";
  EXPECT_EQ(r3.correspondences, 3 * r3.points);
  EXPECT_NEAR(*r3.mse_px2(), 2 * kSigma_px * kSigma_px, 0.06 * 2 * kSigma_px * kSigma_px);
}

TEST(Reconstruct, PosesMayBeFoundFromTheTracks) {
  const Scene scene(4, 0.2);
  std::vector<MatchedPair> pairs;
  for (const auto& [r, t] : {std::pair{0, 1}, {0, 2}, {1, 2}, {1, 3}, {2, 3}})
    pairs.push_back(scene.pair(r, t));
  std::vector<std::optional<Pose>> unknown = scene.poses;
  unknown[2].reset();
  const Reconstruction known =
      reconstruct(scene.frames, scene.poses, pairs, IntrinsicsOrigin::calibration);
  const Reconstruction found =
      reconstruct(scene.frames, unknown, pairs, IntrinsicsOrigin::calibration);
  EXPECT_EQ(found.images, 4);
  EXPECT_NEAR(found.points, known.points, 20);
  EXPECT_NEAR(*found.mse_px2(), *known.mse_px2(), 0.01 * *known.mse_px2());
}

TEST(Reconstruct, AnUnknownLensIsRefinedWhereAsked) {
  Scene scene(5, 0.2, 2000, camera(-0.2));
  std::vector<MatchedPair> pairs;
  for (int r = 0; r < 4; ++r) pairs.push_back(scene.pair(r, r + 1));
  pairs.push_back(scene.pair(0, 2));
  for (FramePtr& frame : scene.frames) {
    auto changed = std::make_shared<Frame>(*frame);
    changed->camera = std::make_shared<const Camera>(camera());
    frame = changed;
  }
  const Reconstruction held =
      reconstruct(scene.frames, scene.poses, pairs, IntrinsicsOrigin::calibration);
  const Reconstruction refined =
      reconstruct(scene.frames, scene.poses, pairs, IntrinsicsOrigin::nominal);
  EXPECT_GE(refined.points, 1990);
  EXPECT_LT(*refined.mse_px2(), 0.15);
  EXPECT_GT(*held.mse_px2(), 2 * *refined.mse_px2());
}

TEST(Reconstruct, ConflictsAndOutliersLeave) {
  const Scene scene(3, 0.2, 500);
  MatchedPair pairs[] = {scene.pair(0, 1), scene.pair(0, 2), scene.pair(1, 2)};
  // Ten points go on in image 2 as their neighbours: two points there, in one track.
  for (std::size_t k = 0; k < 10; ++k) pairs[2].matches[k].point_t = static_cast<int>(k) + 10;
  // Twenty others are wrong by 30 px everywhere in image 2.
  for (std::size_t k = 100; k < 120; ++k) {
    for (const std::size_t p : {1U, 2U}) pairs[p].matches[k].x_t.y() += 30;
  }
  const Reconstruction r =
      reconstruct(scene.frames, scene.poses, pairs, IntrinsicsOrigin::calibration);
  EXPECT_EQ(r.conflicts, 10) << "each of the ten is one track with its neighbour";
  EXPECT_EQ(r.points, 460);
  EXPECT_EQ(r.correspondences, 3 * 460);
  EXPECT_LT(*r.mse_px2(), 0.12);
}

// A point measured twice in an image, within a pixel, is one point: both measurements count.
TEST(Reconstruct, TwoMeasurementsOfOnePointMayDiffer) {
  const Scene scene(3, 0.2, 500);
  MatchedPair pairs[] = {scene.pair(0, 1), scene.pair(0, 2), scene.pair(1, 2)};
  for (Correspondence& m : pairs[2].matches) {
    m.point_t += 10000;
    m.x_t.x() += 0.3;
  }
  const Reconstruction r =
      reconstruct(scene.frames, scene.poses, pairs, IntrinsicsOrigin::calibration);
  EXPECT_EQ(r.conflicts, 0);
  EXPECT_GE(r.points, 498);
  EXPECT_EQ(r.point_images, 3 * r.points);
}

TEST(Reconstruct, NothingComesOfNothing) {
  const Scene scene(3, 0, 5);
  EXPECT_EQ(reconstruct(scene.frames, scene.poses, {}, IntrinsicsOrigin::calibration).points, 0);
  const MatchedPair empty[] = {{0, 1, {}, 1}};
  EXPECT_EQ(reconstruct(scene.frames, scene.poses, empty, IntrinsicsOrigin::calibration).points, 0);
  const MatchedPair few[] = {scene.pair(0, 1)};
  const std::vector<std::optional<Pose>> unknown(3);
  const Reconstruction r = reconstruct(scene.frames, unknown, few, IntrinsicsOrigin::calibration);
  EXPECT_EQ(r.points, 0) << "five matches are no start";
  EXPECT_FALSE(r.mse_px2());
  const std::vector<std::optional<Pose>> still(3, Pose());  // all in one place
  EXPECT_EQ(reconstruct(scene.frames, still, few, IntrinsicsOrigin::calibration).points, 0);
}

FlightOptions flight_options() {
  FlightOptions options = scenes::flight_of(480, 320, 0.75);
  options.rate_hz = 4;
  options.colour = false;
  return options;
}

struct FlightFrames {
  FlightFrames() : flight(flight_options()) {
    for (std::size_t i = 0; i < 3; ++i) frames.push_back(flight.render(i));
  }
  SyntheticFlight flight;
  std::vector<FramePtr> frames;
};

TEST(SiftSide, MatchesTwoFramesOfTheFlight) {
  const FlightFrames f;
  SiftSide sift(1);
  sift.start(f.frames);
  const MatchedPair pair = sift.match(0, 1);
  EXPECT_EQ(pair.reference, 0);
  EXPECT_EQ(pair.target, 1);
  EXPECT_GT(pair.ms, 0);
  EXPECT_GE(pair.matches.size(), 200U);
  const auto F = true_fundamental(f.flight.camera(), f.flight.true_pose(0), f.flight.true_pose(1));
  Tally tally;
  tally.add(f.flight.camera(), pair, F);
  EXPECT_LT(*tally.figures().all.truth_px, 0.4);
  EXPECT_LT(*tally.figures().all.wrong_percent, 3);
  // One name is one place, so that pairs chain.
  std::map<int, Eigen::Vector2d> place;
  for (const Correspondence& m : pair.matches) place.emplace(m.point_t, m.x_t);
  int chained = 0;
  for (const Correspondence& m : sift.match(1, 2).matches) {
    const auto it = place.find(m.point_r);
    if (it == place.end()) continue;
    ++chained;
    EXPECT_EQ(it->second, m.x_r);
  }
  EXPECT_GE(chained, 100);
}

TEST(SiftSide, BlackImagesHaveNoMatches) {
  auto black = std::make_shared<Frame>();
  black->grey = GreyImage(200, 150);
  black->camera = std::make_shared<const Camera>(camera());
  const std::vector<FramePtr> frames{black, black};
  SiftSide sift(2);
  sift.start(frames);
  EXPECT_THAT(sift.match(0, 1).matches, IsEmpty());
}

TEST(CorvidSide, WhatWasFoundInAnImageIsLookedForFromThere) {
  const FlightFrames f;
  auto device = Device::open("auto");
  ASSERT_TRUE(device) << device.error().to_string();
  auto matcher = PairMatcher::create(*device, MatchingOptions{});
  ASSERT_TRUE(matcher) << matcher.error().to_string();
  CorvidSide side(**matcher, 1);
  side.start(f.frames);
  const MatchedPair first = side.match(0, 1), far = side.match(0, 2), second = side.match(1, 2);
  ASSERT_GE(first.matches.size(), 200U);
  EXPECT_GT(first.ms, 0);
  std::map<int, Eigen::Vector2d> found;
  for (const Correspondence& m : first.matches) {
    EXPECT_TRUE(found.emplace(m.point_t, m.x_t).second) << "a name of its own";
  }
  std::set<int> names;
  for (const Correspondence& m : far.matches) names.insert(m.point_t);
  std::size_t chained = 0;
  for (const Correspondence& m : second.matches) {
    EXPECT_TRUE(names.insert(m.point_t).second) << "a measurement of its own";
    const auto it = found.find(m.point_r);
    if (it == found.end()) continue;
    ++chained;
    EXPECT_LT((it->second - m.x_r).norm(), 1e-9) << "the same point of image 1";
  }
  EXPECT_GE(chained, first.matches.size() / 2);
  for (const auto& [matched, r, t] : {std::tuple{&first, 0, 1}, {&far, 0, 2}, {&second, 1, 2}}) {
    Tally tally;
    tally.add(f.flight.camera(), *matched,
              true_fundamental(f.flight.camera(), f.flight.true_pose(static_cast<std::size_t>(r)),
                               f.flight.true_pose(static_cast<std::size_t>(t))));
    EXPECT_LT(*tally.figures().all.truth_px, 0.4);
  }
}

TEST(MatchingBench, MeasuresTheFlight) {
  auto device = Device::open("auto");
  ASSERT_TRUE(device) << device.error().to_string();
  std::vector<MatchingSet> sets;
  sets.push_back({"flight", std::make_unique<SyntheticFlight>(flight_options())});
  MatchingReport report;
  const auto done = run_matching_bench(*device, sets, {}, {}, report);
  ASSERT_TRUE(done) << done.error().to_string();
  ASSERT_EQ(report.rows.size(), 1U);
  const MatchingRow& row = report.rows[0];
  EXPECT_EQ(row.images, 3);
  for (const SideFigures& side : {row.sift, row.corvid}) {
    EXPECT_EQ(side.all.pairs, 3);
    EXPECT_EQ(side.gap1.pairs, 2);
    EXPECT_EQ(side.gap1.matches + side.gap2.matches, side.all.matches);
    EXPECT_GT(side.points, 100);
    EXPECT_LT(*side.mse_px2, 0.5);
    EXPECT_LT(*side.all.truth_px, 0.4);
    EXPECT_GT(side.all.ms, 0);
    EXPECT_GE(side.all.slowest_ms, side.all.ms);
  }
}

TEST(MatchingBench, RefusesWhatItCannotMeasure) {
  auto device = Device::open("auto");
  ASSERT_TRUE(device) << device.error().to_string();
  FlightOptions one = flight_options();
  one.duration_s = 0.25;
  std::vector<MatchingSet> sets;
  sets.push_back({"one_frame", std::make_unique<SyntheticFlight>(one)});
  MatchingReport report;
  auto done = run_matching_bench(*device, sets, {}, {}, report);
  ASSERT_FALSE(done);
  EXPECT_EQ(done.error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(done.error().where, "one_frame");
  MatchingBenchOptions options;
  options.pairs = 2;
  EXPECT_FALSE(run_matching_bench(*device, sets, options, {}, report));
}

}  // namespace
}  // namespace corvid
