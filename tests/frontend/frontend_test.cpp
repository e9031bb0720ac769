#include "frontend/frontend.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <numbers>

#include "frontend/disambiguate/weak_corners.h"
#include "frontend/frontend_scenes.h"

namespace corvid {
namespace {

using test::device;
using test::small_flight;
using test::TruthErrors;

TEST(WeakCorners, KnowWhereTheDetectorGivesScores) {
  auto corners = CornerDetector::create(device());
  auto pyramids = PyramidBuilder::create(device());
  ASSERT_TRUE(corners && pyramids);
  GreyImage image(40, 30);
  for (int y = 0; y < 30; ++y)
    for (int x = 0; x < 40; ++x)
      image(x, y) = static_cast<std::uint8_t>((x * x * 7 + y * x * 3 + y * y * 5) % 251);
  const auto pyramid = pyramids->build(image, 1, Lane::tracking);
  std::vector<Eigen::Vector2f> points;
  for (float y = 0; y < 30; y += 0.5F)
    for (float x = 0; x < 40; x += 0.5F) points.emplace_back(x, y);
  const auto scores = corners->score_at(pyramid->level(0), points, 0.04);
  for (std::size_t i = 0; i < points.size(); ++i)
    EXPECT_EQ(has_corner_score(points[i], 40, 30), scores[i].lambda_min > 0)
        << points[i].transpose();
}

TEST(WeakCorners, AreTakenWhateverTheExposure) {
  auto corners = CornerDetector::create(device());
  auto pyramids = PyramidBuilder::create(device());
  ASSERT_TRUE(corners && pyramids);
  const GreyImage image = SyntheticFlight(small_flight()).render(0)->grey;
  CornerOptions corner_options;
  corner_options.max_count = 200;
  corner_options.border_px = 20;
  for (const double gain : {1.0, 0.4, 0.2}) {
    GreyImage darker = image;
    for (int y = 0; y < image.height(); ++y)
      for (int x = 0; x < image.width(); ++x)
        darker(x, y) = static_cast<std::uint8_t>(gain * image(x, y) + 0.5);
    const Eigen::Vector2d flat(30, 30);
    for (int y = 10; y < 50; ++y)
      for (int x = 10; x < 50; ++x) darker(x, y) = 90;
    const auto r = pyramids->build(image, 1, Lane::tracking);
    const auto t = pyramids->build(darker, 1, Lane::tracking);
    std::vector<Eigen::Vector2d> points;
    std::vector<std::vector<SearchCandidate>> candidates;
    for (const Corner& corner : corners->detect(r->level(0), corner_options)) {
      points.emplace_back(corner.x_px, corner.y_px);
      if ((points.back() - flat).cwiseAbs().maxCoeff() < 30)
        points.pop_back();
      else
        candidates.push_back({{points.back(), 0.9F}, {flat, 0.8F}});
    }
    ASSERT_GT(points.size(), 100U);
    const auto weak = take_weak_corners(*corners, r->level(0), t->level(0), 0, points, 0.04, 5,
                                        candidates, Lane::tracking);
    ASSERT_EQ(weak.size(), points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      ASSERT_EQ(candidates[i].size(), 1U) << "gain " << gain;
      EXPECT_EQ(candidates[i][0].pixel, points[i]);
      ASSERT_EQ(weak[i].size(), 1U);
      EXPECT_EQ(weak[i][0].pixel, flat);
    }
  }
}

TEST(Frontend, TracksOfAFlightStayOnTheScene) {
  const SyntheticFlight flight(small_flight());
  FrontendOptions options;
  options.max_tracks = 400;
  auto frontend = Frontend::create(device(), options, false);
  ASSERT_TRUE(frontend) << frontend.error().to_string();
  struct Birth {
    std::size_t frame;
    Eigen::Vector2d pixel;
  };
  std::map<TrackId, Birth> births;
  std::map<std::size_t, FloatImage> depths;
  TruthErrors errors;
  std::size_t tracked_least = 10000;
  int keyframes = 0;
  for (std::size_t i = 0; i < 30; ++i) {
    const FrameTracks tracks = (*frontend)->process(flight.render(i), nullptr);
    keyframes += tracks.keyframe;
    EXPECT_TRUE(std::is_sorted(tracks.observations.begin(), tracks.observations.end(),
                               [](auto& a, auto& b) { return a.track < b.track; }));
    std::size_t tracked = 0;
    for (const TrackObservation& o : tracks.observations) {
      const auto [birth, fresh] = births.try_emplace(o.track, Birth{i, o.pixel});
      if (fresh) {
        if (!depths.contains(i)) depths[i] = flight.render_depth(i);
        continue;
      }
      ++tracked;
      errors.add(flight, flight.true_pose(birth->second.frame), depths[birth->second.frame],
                 birth->second.pixel, flight.true_pose(i), o.pixel);
    }
    if (i > 0) tracked_least = std::min(tracked_least, tracked);
  }
  std::printf("tracks alive at least: %zu; keyframes: %d; drift median %.3f px, 95 %%: %.3f px\n",
              tracked_least, keyframes, errors.quantile(0.5), errors.quantile(0.95));
  EXPECT_GE(tracked_least, 150U);
  EXPECT_GE(keyframes, 2);
  EXPECT_LT(keyframes, 20);
  ASSERT_GE(errors.px.size(), 2000U);
  EXPECT_LT(errors.quantile(0.5), 0.35);
  EXPECT_LT(errors.quantile(0.95), 1.5);
}

TEST(Frontend, SameInputSameTracks) {
  const SyntheticFlight flight(small_flight());
  std::vector<FrameTracks> runs[2];
  for (auto& run : runs) {
    auto frontend = Frontend::create(device(), {}, false);
    ASSERT_TRUE(frontend);
    for (std::size_t i = 0; i < 6; ++i)
      run.push_back((*frontend)->process(flight.render(i), nullptr));
  }
  for (std::size_t i = 0; i < 6; ++i) {
    ASSERT_EQ(runs[0][i].observations.size(), runs[1][i].observations.size());
    for (std::size_t k = 0; k < runs[0][i].observations.size(); ++k) {
      EXPECT_EQ(runs[0][i].observations[k].track, runs[1][i].observations[k].track);
      EXPECT_EQ(runs[0][i].observations[k].pixel, runs[1][i].observations[k].pixel);
    }
  }
}

TEST(Frontend, StillsTurnedAgainstEachOtherAreMatched) {
  FlightOptions flight_options = small_flight();
  flight_options.path = FlightPath::nadir;
  flight_options.width_px = 640;
  flight_options.height_px = 480;
  const SyntheticFlight flight(flight_options);
  const Pose T_a = flight.true_pose(0);
  const FloatImage depth = flight.render_depth(T_a);
  for (const double turn_deg : {0.0, 25.0, 75.0, 180.0}) {
    // Turned about the viewing axis and moved sideways by a fifth of the height.
    const Pose T_b = T_a * Pose(so3_exp({0, 0, turn_deg * std::numbers::pi / 180}), {6, 2, 0.5});
    auto frontend = Frontend::create(device(), {}, true);
    ASSERT_TRUE(frontend);
    const FrameTracks a = (*frontend)->process(flight.render(T_a, 0), nullptr);
    auto second = std::make_shared<Frame>(*flight.render(T_b, 1));
    second->id = FrameId(1);
    const FrameTracks b = (*frontend)->process(second, nullptr);
    EXPECT_TRUE(a.keyframe && b.keyframe);
    std::map<TrackId, Eigen::Vector2d> first;
    for (const auto& o : a.observations) first[o.track] = o.pixel;
    TruthErrors errors;
    int matched = 0;
    for (const auto& o : b.observations)
      if (const auto it = first.find(o.track); it != first.end()) {
        ++matched;
        errors.add(flight, T_a, depth, it->second, T_b, o.pixel);
      }
    ASSERT_GE(matched, 1500) << "turn " << turn_deg;
    std::printf("turn %.0f deg: %d matches, median %.3f px, 90 %%: %.3f px\n", turn_deg, matched,
                errors.quantile(0.5), errors.quantile(0.9));
    EXPECT_LT(errors.quantile(0.5), 0.15) << "turn " << turn_deg;
    EXPECT_LT(errors.quantile(0.9), 0.6) << "turn " << turn_deg;
  }
}

TEST(Frontend, TracksAreFoundAgainAfterAJump) {
  FlightOptions options = small_flight();
  options.path = FlightPath::nadir;
  const SyntheticFlight flight(options);
  auto frontend = Frontend::create(device(), {}, false);
  ASSERT_TRUE(frontend);
  FrameTracks before;
  for (std::size_t i = 0; i < 4; ++i) before = (*frontend)->process(flight.render(i), nullptr);
  // Turned and moved at once: nothing is within the reach of a prediction.
  const Pose T_a = flight.true_pose(3);
  const Pose T_b = T_a * Pose(so3_exp({0, 0, 0.8}), {5, 3, 0});
  auto jumped = std::make_shared<Frame>(*flight.render(T_b, 4));
  jumped->id = FrameId(4);
  const FrameTracks after = (*frontend)->process(jumped, nullptr);
  const FloatImage depth = flight.render_depth(T_a);
  TruthErrors errors;
  std::size_t kept = 0;
  for (const auto& o : after.observations)
    for (const auto& b : before.observations)
      if (b.track == o.track) {
        ++kept;
        errors.add(flight, T_a, depth, b.pixel, T_b, o.pixel);
      }
  EXPECT_GE(kept, before.observations.size() / 3);
  EXPECT_LT(errors.quantile(0.5), 0.3);
  EXPECT_LT(errors.quantile(0.9), 2);
}

TEST(Frontend, ACoveredLensKeepsTheTracksForAWhile) {
  const SyntheticFlight flight(small_flight());
  auto frontend = Frontend::create(device(), {}, false);
  ASSERT_TRUE(frontend);
  for (std::size_t i = 0; i < 5; ++i) (void)(*frontend)->process(flight.render(i), nullptr);
  const FrameTracks before = (*frontend)->process(flight.render(5), nullptr);
  for (std::size_t i = 6; i < 10; ++i) {
    auto black = std::make_shared<Frame>(*flight.render(i));
    black->grey = GreyImage(black->grey.width(), black->grey.height(), 0);
    EXPECT_TRUE((*frontend)->process(black, nullptr).observations.empty());
  }
  const FrameTracks after = (*frontend)->process(flight.render(6), nullptr);
  std::size_t kept = 0;
  for (const auto& o : after.observations)
    kept += std::any_of(before.observations.begin(), before.observations.end(),
                        [&](auto& b) { return b.track == o.track; });
  EXPECT_GE(kept, before.observations.size() / 2);
}

TEST(Frontend, AFrameWithoutTextureGivesNoTracks) {
  auto frontend = Frontend::create(device(), {}, false);
  ASSERT_TRUE(frontend);
  auto frame = std::make_shared<Frame>();
  frame->id = FrameId(0);
  frame->grey = GreyImage(320, 240, 128);
  frame->camera =
      std::make_shared<Camera>(Camera{CameraModel::pinhole, 320, 240, 300, 300, 160, 120, {}});
  for (int i = 0; i < 3; ++i) {
    const FrameTracks tracks = (*frontend)->process(frame, nullptr);
    EXPECT_TRUE(tracks.observations.empty());
  }
}

}  // namespace
}  // namespace corvid
