#include "frontend/window_matcher.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cstdlib>
#include <map>
#include <set>

#include "replay/synthetic_flight.h"

namespace corvid {
namespace {

std::shared_ptr<Device> device() {
  const char* choice = std::getenv("CORVID_TEST_DEVICE");
  static const auto opened = Device::open(choice ? choice : "auto");
  if (!opened) throw std::runtime_error(opened.error().to_string());
  return *opened;
}

std::unique_ptr<SyntheticFlight> make_flight() {
  FlightOptions options;
  options.width_px = 376;
  options.height_px = 240;
  options.colour = false;
  auto flight = SyntheticFlight::open(options);
  if (!flight) throw std::runtime_error(flight.error().to_string());
  return std::move(*flight);
}

std::unique_ptr<WindowMatcher> make_window(int frames) {
  MatchingOptions options;
  options.window_frames = frames;
  auto window = WindowMatcher::create(device(), options);
  if (!window) throw std::runtime_error(window.error().to_string());
  return std::move(*window);
}

/// Observations of each track, by position of the frame.
using Tracks = std::map<TrackId, std::map<std::size_t, Eigen::Vector2d>>;

void collect(const WindowFrame& seen, std::size_t frame, Tracks& tracks) {
  std::set<TrackId> once;
  EXPECT_TRUE(std::is_sorted(seen.observations.begin(), seen.observations.end(),
                             [](const auto& a, const auto& b) { return a.track < b.track; }));
  for (const TrackObservation& o : seen.observations) {
    EXPECT_TRUE(once.insert(o.track).second) << "a track has two places";
    EXPECT_TRUE(o.pixel.allFinite() && o.covariance_px2.allFinite());
    tracks[o.track][frame] = o.pixel;
  }
}

std::size_t count_long(const Tracks& tracks, std::size_t length) {
  return static_cast<std::size_t>(
      std::count_if(tracks.begin(), tracks.end(),
                    [&](const auto& track) { return track.second.size() >= length; }));
}

TEST(WindowMatcher, PairsComeInTheOrderOfTheThesis) {
  using Pairs = std::vector<FramePair>;
  EXPECT_EQ(window_pairs(4), (Pairs{{0, 1}, {1, 2}, {2, 3}, {0, 2}, {1, 3}, {0, 3}}));
  EXPECT_EQ(window_pairs(4, 3), (Pairs{{2, 3}, {1, 3}, {0, 3}}));
  EXPECT_EQ(window_pairs(2, 1), (Pairs{{0, 1}}));
  EXPECT_TRUE(window_pairs(1).empty());
}

TEST(WindowMatcher, PlacesThatAgreeGiveTheSurestOne) {
  const Eigen::Matrix2d sure = 0.01 * Eigen::Matrix2d::Identity(), rough = 25 * sure;
  const std::vector<TrackPlace> agree{{{10, 10}, rough, 0.9F}, {{10.3, 9.9}, sure, 0.8F}};
  const auto place = agreed_place(agree);
  ASSERT_TRUE(place);
  EXPECT_EQ(place->pixel, agree[1].pixel);
  const std::vector<TrackPlace> torn{{{10, 10}, sure, 0.9F}, {{14, 10}, sure, 0.9F}};
  EXPECT_FALSE(agreed_place(torn));
}

TEST(WindowMatcher, TracksFollowTheTruthAndLastLonger) {
  const auto flight = make_flight();
  const std::vector<std::size_t> frames{0, 5, 10, 15, 20};
  Tracks wide, narrow;
  const auto four = make_window(4), two = make_window(2);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const GreyImage image = flight->render(frames[i])->grey;
    const WindowFrame seen = four->add(image, flight->camera());
    EXPECT_EQ(seen.pairs.size(), std::min<std::size_t>(i, 3));
    collect(seen, i, wide);
    collect(two->add(image, flight->camera()), i, narrow);
  }
  EXPECT_GT(count_long(wide, 3), 300U);
  EXPECT_GT(count_long(wide, 3), count_long(narrow, 3));

  std::vector<double> errors_px;
  const Camera& camera = flight->camera();
  std::vector<FloatImage> depths;
  for (std::size_t frame : frames) depths.push_back(flight->render_depth(frame));
  for (const auto& [id, places] : wide) {
    if (places.size() < 2) continue;
    const auto& [first, x] = *places.begin();
    const int u = static_cast<int>(std::lround(x.x())), v = static_cast<int>(std::lround(x.y()));
    if (!depths[first].contains(u, v, 3)) continue;
    const double z = depths[first](u, v);
    bool edge = !(z > 0);
    for (int dy = -3; dy <= 3; ++dy)
      for (int dx = -3; dx <= 3; ++dx)
        edge = edge || std::abs(depths[first](u + dx, v + dy) - z) > 0.03 * z;
    const auto ray = camera.unproject(x);
    if (edge || !ray) continue;
    const Eigen::Vector3d p = flight->true_pose(frames[first]) * (*ray * (z / ray->z()));
    const auto& [last, y] = *places.rbegin();
    if (const auto seen = camera.project(flight->true_pose(frames[last]).inverse() * p))
      errors_px.push_back((*seen - y).norm());
  }
  ASSERT_GT(errors_px.size(), 300U);
  std::sort(errors_px.begin(), errors_px.end());
  EXPECT_LT(errors_px[errors_px.size() / 2], 0.15);
  EXPECT_LT(errors_px[errors_px.size() * 99 / 100], 3);
}

TEST(WindowMatcher, AFrameWithoutOverlapIsBridged) {
  const auto flight = make_flight();
  const auto window = make_window(3);
  GreyImage black(flight->camera().width_px, flight->camera().height_px);
  std::fill_n(black.data(), static_cast<std::size_t>(black.width()) * black.height(),
              std::uint8_t{0});
  Tracks tracks;
  collect(window->add(flight->render(0)->grey, flight->camera()), 0, tracks);
  const WindowFrame nothing = window->add(black, flight->camera());
  EXPECT_TRUE(nothing.observations.empty());
  ASSERT_EQ(nothing.pairs.size(), 1U);
  EXPECT_FALSE(nothing.pairs[0].refusal.empty());
  const WindowFrame back = window->add(flight->render(5)->grey, flight->camera());
  EXPECT_GT(back.carried, 200U) << "the black frame tore the tracks";
}

TEST(WindowMatcher, EndedTracksAreFollowedNoMoreAndRunsRepeat) {
  const auto flight = make_flight();
  const auto a = flight->render(0)->grey, b = flight->render(5)->grey;
  const auto one = make_window(4), two = make_window(4), three = make_window(4);
  (void)one->add(a, flight->camera());
  (void)two->add(a, flight->camera());
  (void)three->add(a, flight->camera());
  const WindowFrame seen = one->add(b, flight->camera());
  const WindowFrame again = two->add(b, flight->camera());
  ASSERT_EQ(seen.observations.size(), again.observations.size());
  for (std::size_t i = 0; i < seen.observations.size(); ++i)
    ASSERT_EQ(seen.observations[i].pixel, again.observations[i].pixel);
  ASSERT_GT(seen.carried, 10U);
  const std::vector<TrackId> ended{seen.observations[3].track, seen.observations[7].track};
  three->end(ended);
  for (const TrackObservation& o : three->add(b, flight->camera()).observations)
    EXPECT_TRUE(o.track != ended[0] && o.track != ended[1]);
}

}  // namespace
}  // namespace corvid
