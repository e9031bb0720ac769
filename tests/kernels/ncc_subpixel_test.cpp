#include <gtest/gtest.h>

#include <Eigen/Core>

#include "kernels/ncc.h"
#include "kernels/test_device.h"
#include "kernels/textures.h"
#include "oracle/ncc.h"

namespace corvid {
namespace {

struct Errors {
  double median = 0, p95 = 0;
  int found = 0, asked = 0;
};

// Templates on a grid with fractional centres; the target is the texture moved by (sx, sy), with
// another gain and offset.
Errors errors_of_shift(NccMatcher& matcher, const Texture& texture, double sx, double sy,
                       const NccOptions& options) {
  const GreyImage reference = paint(220, 160, [&](int x, int y) { return texture(x, y); });
  const GreyImage target =
      paint(220, 160, [&](int x, int y) { return 20 + 0.8 * texture(x - sx, y - sy); });
  std::vector<NccJob> jobs;
  std::mt19937 random(2);
  for (int y = 20; y < 140; y += 10)
    for (int x = 20; x < 200; x += 10) {
      NccJob job;
      job.template_x_px = static_cast<float>(x + (random() % 100) / 100.);
      job.template_y_px = static_cast<float>(y + (random() % 100) / 100.);
      job.window_x_px = x;
      job.window_y_px = y;
      job.radius_x_px = job.radius_y_px = 6;
      jobs.push_back(job);
    }
  const auto results = matcher.match(upload(*test_device(), reference),
                                     upload(*test_device(), target), jobs, options);
  std::vector<double> errors;
  for (std::size_t i = 0; i < jobs.size(); ++i) {
    if (results[i].count == 0) continue;
    const NccPeak& p = results[i].peaks[0];
    errors.push_back(
        std::hypot(p.x_px - jobs[i].template_x_px - sx, p.y_px - jobs[i].template_y_px - sy));
  }
  std::sort(errors.begin(), errors.end());
  Errors e;
  e.asked = static_cast<int>(jobs.size());
  e.found = static_cast<int>(errors.size());
  if (!errors.empty()) {
    e.median = errors[errors.size() / 2];
    e.p95 = errors[errors.size() * 95 / 100];
  }
  return e;
}

constexpr std::pair<double, double> kShifts[] = {{0, 0},     {2, -1},       {0.5, 0.5},
                                                 {1.3, 0.2}, {-2.25, 1.75}, {0.1, -0.9}};

TEST(NccSubpixel, ShiftsOfBandLimitedTextureAreFound) {
  auto matcher = make<NccMatcher>();
  for (const double frequency : {0.1, 0.15, 0.18}) {
    const Texture texture(frequency, 21);
    for (const auto& [sx, sy] : kShifts) {
      const Errors e = errors_of_shift(matcher, texture, sx, sy, {});
      EXPECT_LE(e.median, 0.02) << frequency << " " << sx << " " << sy;
      EXPECT_LE(e.p95, 0.04) << frequency << " " << sx << " " << sy;
      EXPECT_GE(e.found, e.asked * 95 / 100) << frequency << " " << sx << " " << sy;
    }
  }
}

TEST(NccSubpixel, GaussianWeightsFindThemToo) {
  auto matcher = make<NccMatcher>();
  NccOptions options;
  options.template_px = 15;
  options.weights = NccWeights::gaussian;
  const Texture texture(0.15, 22);
  for (const auto& [sx, sy] : kShifts) {
    const Errors e = errors_of_shift(matcher, texture, sx, sy, options);
    EXPECT_LE(e.median, 0.025) << sx << " " << sy;
    EXPECT_GE(e.found, e.asked * 95 / 100) << sx << " " << sy;
  }
}

TEST(NccSubpixel, AlignmentBeatsTheQuadratic) {
  auto matcher = make<NccMatcher>();
  NccOptions quadratic;
  quadratic.align_iterations = 0;
  const Texture texture(0.1, 23);
  const Errors plain = errors_of_shift(matcher, texture, 1.3, 0.2, quadratic);
  const Errors aligned = errors_of_shift(matcher, texture, 1.3, 0.2, {});
  EXPECT_LE(plain.median, 0.25);
  EXPECT_LT(aligned.median, plain.median / 3);
}

// The aligned place is a maximum of the definition, and its score is what the definition gives.
TEST(NccSubpixel, AlignedPeaksAreMaximaOfTheOracle) {
  auto matcher = make<NccMatcher>();
  for (const bool gaussian : {false, true}) {
    NccOptions options;
    if (gaussian) options.weights = NccWeights::gaussian;
    const Texture texture(0.2, 24);
    const GreyImage reference = paint(120, 90, [&](int x, int y) { return texture(x, y); });
    const GreyImage target = paint(
        120, 90, [&](int x, int y) { return texture(1.02 * x - 0.03 * y - 1, 0.99 * y + 0.6); });
    std::vector<NccJob> jobs;
    for (int y = 25; y < 70; y += 9)
      for (int x = 25; x < 95; x += 9) {
        NccJob job;
        job.template_x_px = x + 0.3F;
        job.template_y_px = y + 0.6F;
        job.window_x_px = x;
        job.window_y_px = y;
        job.radius_x_px = job.radius_y_px = 6;
        jobs.push_back(job);
      }
    const auto results = matcher.match(upload(*test_device(), reference),
                                       upload(*test_device(), target), jobs, options);
    const auto w = oracle::ncc_weights(oracle::ncc_shape(11, 11, gaussian));
    constexpr float kIdentity[4] = {1, 0, 0, 1};
    int maxima = 0, found = 0;
    for (std::size_t i = 0; i < jobs.size(); ++i) {
      if (results[i].count == 0) continue;
      ++found;
      const NccPeak& p = results[i].peaks[0];
      const auto t = oracle::sample_template(reference, jobs[i].template_x_px,
                                             jobs[i].template_y_px, kIdentity, 11, 11);
      const auto score = [&](double dx, double dy) {
        return *oracle::correlate(
            t, oracle::sample_template(target, p.x_px + dx, p.y_px + dy, kIdentity, 11, 11), w, 0,
            0);
      };
      bool maximum = std::abs(score(0, 0) - p.score) < 1e-3;
      for (const auto& [dx, dy] : {std::pair{0.1, 0.}, {-0.1, 0.}, {0., 0.1}, {0., -0.1}})
        maximum = maximum && score(0, 0) > score(dx, dy);
      maxima += maximum;
    }
    EXPECT_GE(found, static_cast<int>(jobs.size()) * 9 / 10);
    EXPECT_GE(maxima, found * 95 / 100) << gaussian;
  }
}

// A template warped by the affinity between the views finds what an unwarped one cannot.
TEST(NccSubpixel, WarpedTemplatesFollowRotation) {
  auto matcher = make<NccMatcher>();
  const Texture texture(0.15, 25);
  const double angle = 0.5, c = std::cos(angle), s = std::sin(angle);
  // Target point q shows texture point R (q - centre) + centre.
  const GreyImage reference = paint(160, 160, [&](int x, int y) { return texture(x, y); });
  const GreyImage target = paint(160, 160, [&](int x, int y) {
    const double dx = x - 80, dy = y - 80;
    return texture(80 + c * dx - s * dy, 80 + s * dx + c * dy);
  });
  std::vector<NccJob> jobs;
  std::vector<Eigen::Vector2d> truth;
  for (int y = 50; y <= 110; y += 12)
    for (int x = 50; x <= 110; x += 12) {
      NccJob job;
      const double dx = x + 0.37 - 80, dy = y + 0.81 - 80;
      truth.emplace_back(x + 0.37, y + 0.81);
      job.template_x_px = static_cast<float>(80 + c * dx - s * dy);
      job.template_y_px = static_cast<float>(80 + s * dx + c * dy);
      const float warp[4] = {static_cast<float>(c), static_cast<float>(-s), static_cast<float>(s),
                             static_cast<float>(c)};
      std::copy_n(warp, 4, job.warp);
      job.window_x_px = x + 1;
      job.window_y_px = y;
      job.radius_x_px = job.radius_y_px = 5;
      jobs.push_back(job);
    }
  const auto results =
      matcher.match(upload(*test_device(), reference), upload(*test_device(), target), jobs, {});
  std::vector<double> errors;
  for (std::size_t i = 0; i < jobs.size(); ++i) {
    ASSERT_GE(results[i].count, 1) << i;
    EXPECT_GT(results[i].peaks[0].score, 0.99);
    errors.push_back(std::hypot(results[i].peaks[0].x_px - truth[i].x(),
                                results[i].peaks[0].y_px - truth[i].y()));
  }
  std::sort(errors.begin(), errors.end());
  EXPECT_LE(errors[errors.size() / 2], 0.02);
  EXPECT_LE(errors.back(), 0.1);
}

}  // namespace
}  // namespace corvid
