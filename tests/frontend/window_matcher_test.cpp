#include "frontend/window_matcher.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/imgproc.hpp>
#include <set>

#include "frontend/frontend_scenes.h"

namespace corvid {
namespace {

using test::device;
using test::small_flight;

TEST(WindowPairs, ComeInTheOrderOfTheThesis) {
  const std::vector<FramePair> first{{0, 1}, {1, 2}, {2, 3}, {0, 2}, {1, 3}, {0, 3}};
  EXPECT_EQ(window_pairs(4), first);
  const std::vector<FramePair> moved{{2, 3}, {1, 3}, {0, 3}};
  EXPECT_EQ(window_pairs(4, 3), moved);
  EXPECT_EQ(window_pairs(2), (std::vector<FramePair>{{0, 1}}));
  EXPECT_TRUE(window_pairs(1).empty());
  EXPECT_TRUE(window_pairs(0).empty());
}

TEST(WindowPairs, OneFrameAtATimeAreTheSamePairsAndNarrowerOnesComeBefore) {
  std::set<FramePair> done;
  for (int frames = 1; frames <= 6; ++frames)
    for (const auto& [reference, target] : window_pairs(frames, frames - 1)) {
      for (int between = reference + 1; between < target; ++between) {
        EXPECT_TRUE(done.contains({reference, between}));
        EXPECT_TRUE(done.contains({between, target}));
      }
      EXPECT_TRUE(done.emplace(reference, target).second) << "matched twice";
    }
  const auto all = window_pairs(6);
  EXPECT_EQ(done, std::set<FramePair>(all.begin(), all.end()));
}

TrackPlace place(double x, double y, double sigma_px) {
  return {{x, y}, sigma_px * sigma_px * Eigen::Matrix2d::Identity(), 0.9F};
}

TEST(AgreedPlace, IsTheMostCertainOneOfThoseThatAgree) {
  const auto agreed =
      agreed_place(std::vector{place(10, 20, 0.2), place(10.1, 20.1, 0.1), place(10.3, 19.9, 0.4)});
  ASSERT_TRUE(agreed);
  EXPECT_EQ(agreed->pixel, Eigen::Vector2d(10.1, 20.1));
  EXPECT_EQ(agreed_place(std::vector{place(3, 4, 5)})->pixel, Eigen::Vector2d(3, 4));
}

TEST(AgreedPlace, IsNoneWherePlacesContradictEachOther) {
  EXPECT_FALSE(agreed_place(std::vector{place(10, 20, 0.1), place(12, 20, 0.1)}));
  EXPECT_FALSE(
      agreed_place(std::vector{place(10, 20, 0.1), place(10.1, 20, 0.1), place(10, 25, 0.3)}));
  EXPECT_TRUE(agreed_place(std::vector{place(10, 20, 0.1), place(12, 20, 2)})) << "uncertain";
  // Along an edge a place may slide, across it may not.
  TrackPlace sliding = place(10, 20, 0.1);
  sliding.covariance_px2(0, 0) = 4;
  EXPECT_TRUE(agreed_place(std::vector{place(12, 20, 0.1), sliding}));
  EXPECT_FALSE(agreed_place(std::vector{place(10, 22, 0.1), sliding}));
}

std::unique_ptr<WindowMatcher> make_window(int frames, MatchingOptions options = {}) {
  options.window_frames = frames;
  auto window = WindowMatcher::create(device(), options);
  if (!window) throw std::runtime_error(window.error().to_string());
  return std::move(*window);
}

/// Frames of a flight, numbered, put through a window.
struct Flown {
  std::vector<std::size_t> numbers;
  std::vector<WindowFrame> frames;
  std::map<TrackId, std::vector<std::size_t>> seen;  ///< indices of `frames`

  Flown(const SyntheticFlight& flight, std::vector<std::size_t> which, int window_frames)
      : numbers(std::move(which)) {
    const auto window = make_window(window_frames);
    for (const std::size_t i : numbers)
      frames.push_back(window->add(flight.render(i)->grey, flight.camera()));
    for (std::size_t k = 0; k < frames.size(); ++k)
      for (const auto& o : frames[k].observations) seen[o.track].push_back(k);
  }
  [[nodiscard]] std::ptrdiff_t at_least(std::size_t length) const {
    return std::count_if(seen.begin(), seen.end(),
                         [&](const auto& entry) { return entry.second.size() >= length; });
  }
  [[nodiscard]] const TrackObservation& find(std::size_t frame, TrackId track) const {
    const auto& all = frames[frame].observations;
    return *std::lower_bound(all.begin(), all.end(), track,
                             [](const auto& o, TrackId id) { return o.track < id; });
  }
};

TEST(WindowMatcher, TracksOfAFlightAreTrueAndLongerThanThoseOfPairs) {
  const SyntheticFlight flight(small_flight());
  const std::vector<std::size_t> numbers{20, 28, 36, 44};
  const Flown window(flight, numbers, 4), pairs(flight, numbers, 2);
  EXPECT_GT(window.at_least(3), pairs.at_least(3));
  EXPECT_GT(window.at_least(3), 1200);
  test::TruthErrors errors;
  std::map<std::size_t, FloatImage> depths;
  for (const auto& [track, at] : window.seen)
    for (std::size_t i = 1; i < at.size(); ++i) {
      const std::size_t a = numbers[at[0]], b = numbers[at[i]];
      if (!depths.contains(a)) depths[a] = flight.render_depth(a);
      errors.add(flight, flight.true_pose(a), depths[a], window.find(at[0], track).pixel,
                 flight.true_pose(b), window.find(at[i], track).pixel);
    }
  std::printf(
      "%zu places, median %.3f px, 90 %%: %.3f px, %.2f %% wrong; of 3 frames and more: %td "
      "tracks, of pairs alone %td\n",
      errors.px.size(), errors.quantile(0.5), errors.quantile(0.9), 100 * errors.share_above(3),
      window.at_least(3), pairs.at_least(3));
  ASSERT_GT(errors.px.size(), 2000U);
  EXPECT_LT(errors.quantile(0.5), 0.15);
  EXPECT_LT(errors.share_above(3), 0.005);
}

TEST(WindowMatcher, ATrackHasOnePlaceAndAPlaceOneTrack) {
  const SyntheticFlight flight(small_flight());
  const Flown flown(flight, {20, 24, 28, 32, 36}, 4);
  std::size_t merged = 0;
  for (std::size_t k = 0; k < flown.frames.size(); ++k) {
    const WindowFrame& frame = flown.frames[k];
    merged += frame.merged;
    const auto& all = frame.observations;
    for (std::size_t i = 1; i < all.size(); ++i) EXPECT_LT(all[i - 1].track, all[i].track);
    for (std::size_t i = 0; i < all.size(); ++i)
      for (std::size_t j = 0; j < i; ++j)
        ASSERT_GE((all[i].pixel - all[j].pixel).norm(), 1.5) << "frame " << k;
    for (std::size_t i = 0; i < all.size(); ++i) {
      EXPECT_EQ(flown.seen.at(all[i].track).front() < k, i < frame.carried);
      EXPECT_TRUE(all[i].covariance_px2.allFinite());
      EXPECT_EQ(all[i].covariance_px2.determinant() > 0, i < frame.carried);
    }
    EXPECT_EQ(frame.pairs.size(), std::min<std::size_t>(k, 3));
    for (std::size_t p = 0; p < frame.pairs.size(); ++p) {
      EXPECT_EQ(frame.pairs[p].target, k);
      EXPECT_EQ(frame.pairs[p].reference, k - 1 - p) << "narrow first";
    }
  }
  EXPECT_GT(merged, 0U) << "features that were lost and detected anew";
}

TEST(WindowMatcher, AWindowOfTwoMatchesNeighboursOnly) {
  const SyntheticFlight flight(small_flight());
  const Flown flown(flight, {20, 24, 28}, 2);
  EXPECT_TRUE(flown.frames[0].pairs.empty());
  EXPECT_EQ(flown.frames[1].pairs.size(), 1U);
  ASSERT_EQ(flown.frames[2].pairs.size(), 1U);
  EXPECT_EQ(flown.frames[2].pairs[0].reference, 1U);
  EXPECT_GT(flown.frames[2].carried, 500U);
  EXPECT_GT(flown.at_least(3), 500);
}

TEST(WindowMatcher, SameInputSameTracks) {
  const SyntheticFlight flight(small_flight());
  const Flown one(flight, {20, 26, 32}, 3), two(flight, {20, 26, 32}, 3);
  for (std::size_t k = 0; k < one.frames.size(); ++k) {
    const auto &a = one.frames[k].observations, &b = two.frames[k].observations;
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t i = 0; i < a.size(); ++i) {
      EXPECT_EQ(a[i].track, b[i].track);
      EXPECT_EQ(a[i].pixel, b[i].pixel);
    }
  }
}

TEST(WindowMatcher, AFrameWithoutOverlapIsBridged) {
  const SyntheticFlight flight(small_flight());
  const GreyImage black(flight.camera().width_px, flight.camera().height_px, 0);
  for (const int window_frames : {2, 4}) {
    const auto window = make_window(window_frames);
    (void)window->add(flight.render(20)->grey, flight.camera());
    const WindowFrame before = window->add(flight.render(24)->grey, flight.camera());
    const WindowFrame dark = window->add(black, flight.camera());
    EXPECT_TRUE(dark.observations.empty());
    EXPECT_EQ(dark.pairs.size(), window_frames == 2 ? 1U : 2U);
    for (const WindowPair& pair : dark.pairs) EXPECT_FALSE(pair.refusal.empty());
    const WindowFrame after = window->add(flight.render(28)->grey, flight.camera());
    EXPECT_FALSE(after.pairs[0].refusal.empty()) << "the narrowest one is with the dark frame";
    std::set<TrackId> known;
    for (const auto& o : before.observations) known.insert(o.track);
    const auto kept = std::count_if(after.observations.begin(), after.observations.end(),
                                    [&](const auto& o) { return known.contains(o.track); });
    if (window_frames == 2) {
      EXPECT_EQ(kept, 0);
    } else {
      EXPECT_GT(kept, 1000);
    }
    EXPECT_LE(static_cast<std::size_t>(kept), after.carried);
  }
}

/// Smooth noise of mean 0 and standard deviation 1.
cv::Mat1f smooth_noise(int side_px, int seed) {
  cv::Mat1f noise(side_px, side_px);
  cv::RNG random(static_cast<std::uint64_t>(seed));
  random.fill(noise, cv::RNG::NORMAL, 0, 1);
  cv::GaussianBlur(noise, noise, {}, 0.8);
  cv::Scalar mean, deviation;
  cv::meanStdDev(noise, mean, deviation);
  return (noise - mean[0]) / deviation[0];
}

/// Two textures over each other, as on a window pane: each has its own place and strength.
struct Pane {
  static constexpr int kHalfPx = 20;
  cv::Mat1f one, other;
  explicit Pane(int seed) : one(smooth_noise(81, seed)), other(smooth_noise(81, seed + 1000)) {}

  void paint(GreyImage& image, const Eigen::Vector2d& place, const Eigen::Vector2d& place_of_one,
             double strength_of_one, const Eigen::Vector2d& place_of_other) const {
    const auto at = [](const cv::Mat1f& texture, const Eigen::Vector2d& x) {
      cv::Mat1f value;
      cv::getRectSubPix(texture, {1, 1},
                        {static_cast<float>(x.x() + 40), static_cast<float>(x.y() + 40)}, value);
      return static_cast<double>(value(0, 0));
    };
    const int u = static_cast<int>(std::lround(place.x())),
              v = static_cast<int>(std::lround(place.y()));
    const double strength_of_other = std::sqrt(1 - strength_of_one * strength_of_one);
    for (int y = v - kHalfPx; y <= v + kHalfPx; ++y)
      for (int x = u - kHalfPx; x <= u + kHalfPx; ++x) {
        if (!image.contains(x, y)) continue;
        const Eigen::Vector2d pixel(x, y);
        const double value = strength_of_one * at(one, pixel - place_of_one) +
                             strength_of_other * at(other, pixel - place_of_other);
        image(x, y) = static_cast<std::uint8_t>(std::clamp(128 + 35 * value, 0.0, 255.0));
      }
  }
};

// Panes show one texture in the first frame, and two in the others. The match of the first with the
// third follows the one, that of the second with the third the other; where they come apart, along
// the epipolar line, the chain contradicts the direct match.
TEST(WindowMatcher, ATrackWhoseChainContradictsItsDirectMatchEnds) {
  const SyntheticFlight flight(small_flight());
  const Camera& camera = flight.camera();
  const std::size_t numbers[] = {20, 24, 28};
  const FloatImage depth = flight.render_depth(numbers[0]);
  MatchingOptions options;
  options.window_frames = 3;
  options.min_score = options.refine_min_score = 0.4;
  std::size_t disagreed[2];
  for (const bool apart : {false, true}) {
    GreyImage images[3];
    for (int k = 0; k < 3; ++k) images[k] = flight.render(numbers[k])->grey;
    int panes = 0;
    for (int v = 40; v < camera.height_px; v += 60)
      for (int u = 40; u < camera.width_px; u += 60) {
        const Eigen::Vector2d x0(u, v);
        const Pose T0 = flight.true_pose(numbers[0]);
        const auto x1 = test::true_place(flight, T0, depth, x0, flight.true_pose(numbers[1]));
        const auto x2 = test::true_place(flight, T0, depth, x0, flight.true_pose(numbers[2]));
        if (!x1 || !x2) continue;
        const Eigen::Vector3d ray = *camera.unproject(x0);
        const Eigen::Vector3d further = T0 * Eigen::Vector3d(1.1 * depth(u, v) / ray.z() * ray);
        const auto along = camera.project(flight.true_pose(numbers[2]).inverse() * further);
        if (!along) continue;
        const Eigen::Vector2d shift = (apart ? 4.0 : 0.0) * (*along - *x2).normalized();
        const Pane pane(++panes);
        pane.paint(images[0], x0, x0, 1, x0);
        pane.paint(images[1], *x1, *x1, 0.7, *x1);
        pane.paint(images[2], *x2, *x2 - shift, 0.65, *x2 + shift);
      }
    const auto window = make_window(3, options);
    WindowFrame frames[3];
    for (int k = 0; k < 3; ++k) frames[k] = window->add(images[k], camera);
    disagreed[apart] = frames[2].disagreed;
    EXPECT_EQ(frames[1].disagreed, 0U) << "one match alone contradicts nothing";
    EXPECT_GT(frames[2].carried, 300U);
  }
  EXPECT_EQ(disagreed[0], 0U);
  EXPECT_GT(disagreed[1], 10U);
}

TEST(WindowMatcher, EndedTracksDoNotComeBack) {
  const SyntheticFlight flight(small_flight());
  const auto window = make_window(4);
  (void)window->add(flight.render(20)->grey, flight.camera());
  const WindowFrame second = window->add(flight.render(24)->grey, flight.camera());
  ASSERT_GT(second.carried, 1000U);
  std::vector<TrackId> ended;
  for (std::size_t i = 0; i < second.carried; i += 2) ended.push_back(second.observations[i].track);
  window->end(ended);
  window->end(std::vector{TrackId(1234567)});  // of no track: nothing happens
  const WindowFrame third = window->add(flight.render(28)->grey, flight.camera());
  EXPECT_GT(third.carried, 400U);
  for (const auto& o : third.observations)
    EXPECT_FALSE(std::binary_search(ended.begin(), ended.end(), o.track));
}

TEST(WindowMatcher, ImagesOfAnySizeHaveAnAnswer) {
  const auto window = make_window(4);
  const auto add = [&](int width, int height) {
    return window->add(
        GreyImage(width, height, 90),
        Camera{CameraModel::pinhole, width, height, 100, 100, 0.5 * width, 0.5 * height, {}});
  };
  for (const auto& [width, height] : {std::pair{16, 16}, {200, 60}, {64, 300}}) {
    const WindowFrame frame = add(width, height);
    EXPECT_TRUE(frame.observations.empty());
    for (const WindowPair& pair : frame.pairs) EXPECT_FALSE(pair.refusal.empty());
  }
}

}  // namespace
}  // namespace corvid
