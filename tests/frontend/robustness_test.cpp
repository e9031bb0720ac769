// What changes of light do to tracks, and how tracks are spread over the image.
#include <gtest/gtest.h>

#include <functional>
#include <map>

#include "frontend/frontend.h"
#include "frontend/frontend_scenes.h"

namespace corvid {
namespace {

using test::device;

using Light = std::function<double(std::size_t frame, int x, int y, double grey)>;

std::shared_ptr<Frame> relit(const FramePtr& frame, std::size_t index, const Light& light) {
  auto changed = std::make_shared<Frame>(*frame);
  for (int y = 0; y < changed->grey.height(); ++y)
    for (int x = 0; x < changed->grey.width(); ++x) {
      std::uint8_t& grey = changed->grey(x, y);
      grey = static_cast<std::uint8_t>(std::clamp(light(index, x, y, grey) + 0.5, 0.0, 255.0));
    }
  return changed;
}

struct Outcome {
  double alive = 0;     ///< of the tracks of the first frame, in the last
  double drift_px = 0;  ///< of these, median
  std::size_t count = 0;
};

constexpr std::size_t kFrames = 12, kChange = 6;  // where steps come

/// The flight under a light that changes.
Outcome fly(const Light& light) {
  static const SyntheticFlight flight(test::small_flight());
  static const std::vector<FramePtr> frames = [] {
    std::vector<FramePtr> rendered;
    for (std::size_t i = 0; i < kFrames; ++i) rendered.push_back(flight.render(i));
    return rendered;
  }();
  static const FloatImage depth = flight.render_depth(0);
  FrontendOptions options;
  options.max_tracks = 400;
  auto frontend = Frontend::create(device(), options, false);
  if (!frontend) throw std::runtime_error(frontend.error().to_string());
  std::map<TrackId, Eigen::Vector2d> first;
  FrameTracks last;
  for (std::size_t i = 0; i < kFrames; ++i) {
    last = (*frontend)->process(relit(frames[i], i, light), nullptr);
    if (i == 0)
      for (const auto& o : last.observations) first[o.track] = o.pixel;
  }
  Outcome outcome;
  std::vector<double> drift_px;
  for (const auto& o : last.observations) {
    const auto birth = first.find(o.track);
    if (birth == first.end()) continue;
    ++outcome.count;
    const auto x = test::true_place(flight, flight.true_pose(0), depth, birth->second,
                                    flight.true_pose(kFrames - 1));
    if (x) drift_px.push_back((*x - o.pixel).norm());
  }
  outcome.alive = static_cast<double>(outcome.count) / static_cast<double>(first.size());
  outcome.drift_px = test::quantile(drift_px, 0.5);
  return outcome;
}

TEST(Photometry, TracksSurviveChangesOfTheLight) {
  const Outcome constant = fly([](std::size_t, int, int, double grey) { return grey; });
  EXPECT_GT(constant.alive, 0.5);
  struct Case {
    const char* name;
    double share;  ///< of those that constant light leaves alive
    Light light;
  };
  const auto step = [](double gain) {
    return
        [gain](std::size_t i, int, int, double grey) { return i < kChange ? grey : gain * grey; };
  };
  const Case cases[] = {
      {"half the exposure", 0.9, step(0.5)},
      // Most of a bright scene saturates: what is clipped holds nothing to be found.
      {"double the exposure, clipped", 0.5, step(2)},
      {"exposure that flickers by a third", 0.9,
       [](std::size_t i, int, int, double grey) { return i % 2 == 0 ? grey : 0.67 * grey; }},
      {"gamma 2.2 from one frame to the next", 0.9,
       [](std::size_t i, int, int, double grey) {
         return i < kChange ? grey : 255 * std::pow(grey / 255, 1 / 2.2);
       }},
      {"vignetting that takes 70 % in the corners", 0.9,
       [](std::size_t, int x, int y, double grey) {
         const double r2 = (std::pow(x - 239.5, 2) + std::pow(y - 159.5, 2)) /
                           (std::pow(239.5, 2) + std::pow(159.5, 2));
         return grey * (1 - 0.7 * r2);
       }},
      {"a lamp that moves through the image", 0.8, [](std::size_t i, int x, int, double grey) {
         const double d = (x - 40.0 * static_cast<double>(i)) / 120;
         return grey * (0.6 + 0.5 * std::exp(-d * d));
       }}};
  for (const Case& c : cases) {
    const Outcome outcome = fly(c.light);
    std::printf("%s: %.0f %% alive (constant light: %.0f %%), drift %.3f px (%.3f px)\n", c.name,
                100 * outcome.alive, 100 * constant.alive, outcome.drift_px, constant.drift_px);
    EXPECT_GT(outcome.alive, c.share * constant.alive) << c.name;
    EXPECT_LT(outcome.drift_px, 1.5 * constant.drift_px + 0.05) << c.name;
  }
}

// Cells of an 8x6 grid in which the image has a corner, and those of them that have a track.
TEST(Spread, EveryTexturedPartOfTheImageHasTracks) {
  const SyntheticFlight flight(test::small_flight());
  FrontendOptions options;
  options.max_tracks = 300;
  auto frontend = Frontend::create(device(), options, false);
  auto corners = CornerDetector::create(device());
  auto pyramids = PyramidBuilder::create(device());
  ASSERT_TRUE(frontend && corners && pyramids);
  const auto cell = [](double x, double y) {
    return static_cast<int>(x * 8 / 480) + 8 * static_cast<int>(y * 6 / 320);
  };
  for (std::size_t i = 0; i < 25; ++i) {
    const FramePtr frame = flight.render(i);
    const FrameTracks tracks = (*frontend)->process(frame, nullptr);
    if (!tracks.keyframe) continue;
    CornerOptions corner_options;
    corner_options.quality = options.corner_quality;
    corner_options.kappa = options.harris_kappa;
    corner_options.border_px = options.template_px / 2 + 2;
    const auto pyramid = pyramids->build(frame->grey, 1);
    std::map<int, int> textured, tracked;
    for (const Corner& corner : corners->detect(pyramid->level(0), corner_options))
      ++textured[cell(corner.x_px, corner.y_px)];
    for (const auto& o : tracks.observations) ++tracked[cell(o.pixel.x(), o.pixel.y())];
    int empty = 0, most = 0;
    for (const auto& [index, count] : textured) empty += tracked[index] == 0;
    for (const auto& [index, count] : tracked) most = std::max(most, count);
    std::printf("frame %zu: %d of %zu textured cells empty, %d tracks in the fullest\n", i, empty,
                textured.size(), most);
    EXPECT_LE(empty, static_cast<int>(textured.size() / 10)) << "frame " << i;
    EXPECT_LE(most, 5 * options.max_tracks / 48) << "frame " << i;
  }
}

// Two patches that slide together until they are one: two tracks become one.
TEST(Merging, TwoTracksOnOneFeatureBecomeOne) {
  const auto patch = [](GreyImage& image, double cx, double cy, int kind) {
    for (int y = -9; y <= 9; ++y)
      for (int x = -9; x <= 9; ++x) {
        const double u = x - (cx - std::floor(cx)), v = y - (cy - std::floor(cy));
        const double r2 = u * u + v * v;
        if (r2 > 81) continue;
        const double wave =
            std::cos(0.55 * u + 0.1 * kind * v) * std::cos(0.5 * v - 0.07 * kind * u);
        std::uint8_t& grey = image(static_cast<int>(cx) + x, static_cast<int>(cy) + y);
        grey = static_cast<std::uint8_t>(128 + 100 * wave * std::exp(-r2 / 30));
      }
  };
  auto frontend = Frontend::create(device(), {}, false);
  ASSERT_TRUE(frontend);
  const auto camera =
      std::make_shared<Camera>(Camera{CameraModel::pinhole, 480, 320, 400, 400, 240, 160, {}});
  int merged = 0;
  std::size_t twins = 0;
  for (int i = 0; i < 40; ++i) {
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(i));
    frame->grey = GreyImage(480, 320, 128);
    frame->camera = camera;
    // The scene moves to the right, one patch slower than the others until it is where its twin is.
    for (int k = 0; k < 24; ++k)
      patch(frame->grey, 40 + 50 * (k % 6) + 2.0 * i, 40 + 60 * (k / 6), k);
    const double apart = std::max(0.0, 24.0 - 1.0 * i);
    patch(frame->grey, 60 + 2.0 * i + apart, 280, 3);
    patch(frame->grey, 60 + 2.0 * i, 280, 3);
    const FrameTracks tracks = (*frontend)->process(frame, nullptr);
    merged += (*frontend)->last_counts().merged;
    if (!tracks.keyframe || apart > 0) continue;
    for (std::size_t a = 0; a < tracks.observations.size(); ++a)
      for (std::size_t b = a + 1; b < tracks.observations.size(); ++b) {
        const double d = (tracks.observations[a].pixel - tracks.observations[b].pixel).norm();
        if (d < 1.5) ++twins;
      }
  }
  EXPECT_GT(merged, 0);
  EXPECT_EQ(twins, 0U) << "tracks on one feature at a keyframe";
}

}  // namespace
}  // namespace corvid
