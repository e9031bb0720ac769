#include "kernels/ncc_frequency.h"

#include <gtest/gtest.h>

#include <limits>
#include <optional>

#include "kernels/textures.h"
#include "oracle/ncc.h"

namespace corvid {
namespace {

// A job with its memory: the template from the middle of the image, all candidates.
template <class Pixel>
struct HostJob {
  Image<Pixel> image;
  oracle::NccShape shape;
  std::vector<double> weights, samples;
  std::vector<float> taps, means, inverses;
  FrequencyJob job;

  HostJob(Image<Pixel> pixels, int width, int height, bool gaussian, int x = 60, int y = 33)
      : image(std::move(pixels)), shape(oracle::ncc_shape(width, height, gaussian)) {
    weights = oracle::ncc_weights(shape);
    const float identity[4] = {1, 0, 0, 1};
    samples = oracle::sample_template(image, x, y, identity, width, height);
    const auto [mean, variance] = oracle::moments(samples, weights);
    for (std::size_t i = 0; i < weights.size(); ++i)
      taps.push_back(static_cast<float>(weights[i] * (samples[i] - mean) / std::sqrt(variance)));
    const float unset = std::numeric_limits<float>::quiet_NaN();
    means.assign(image.size(), unset);
    inverses.assign(image.size(), unset);
    for (int cy = height / 2; cy < image.height() - height / 2; ++cy)
      for (int cx = width / 2; cx < image.width() - width / 2; ++cx) {
        std::vector<double> s;
        for (int v = -height / 2; v <= height / 2; ++v)
          for (int u = -width / 2; u <= width / 2; ++u) s.push_back(image(cx + u, cy + v));
        const auto m = oracle::moments(s, weights);
        const auto at = static_cast<std::size_t>(cy * image.width() + cx);
        means[at] = static_cast<float>(m.mean);
        // As ncc_at() decides.
        const double least = sizeof(Pixel) != 1 ? std::max(1e-10 * m.mean * m.mean, 1e-30)
                             : gaussian         ? 0.1
                                                : 1e-9;
        inverses[at] = m.variance >= least ? static_cast<float>(1 / std::sqrt(m.variance)) : 0.F;
      }
    job.target = image.data();
    job.format = sizeof(Pixel) == 1 ? PixelFormat::grey8 : PixelFormat::float32;
    job.target_width_px = image.width();
    job.means = means.data();
    job.inverses = inverses.data();
    job.taps = taps.data();
    job.taps_pitch = width;
    job.template_width_px = width;
    job.template_height_px = height;
    job.x_px = width / 2;
    job.y_px = height / 2;
    job.width_px = image.width() - width + 1;
    job.height_px = image.height() - height + 1;
    job.threads = 2;
  }
};

constexpr float kUnwritten = 7;

struct Outcome {
  double worst = 0;      // difference of what was scored
  std::size_t left = 0;  // candidates that were not
};

// Compares every fifth candidate with the definition; checks that exactly what was not returned has
// been written.
template <class Pixel>
Outcome outcome(const HostJob<Pixel>& host) {
  FloatImage scores(host.job.width_px, host.job.height_px, kUnwritten);
  Image<std::uint8_t> is_left(host.job.width_px, host.job.height_px, 0);
  Outcome result;
  for (const CandidateBox& box : score_by_frequency(host.job, scores.data())) {
    EXPECT_LE(box.width_px, 256);
    EXPECT_LE(box.height_px, 16);
    for (int y = box.y_px; y < box.y_px + box.height_px; ++y)
      for (int x = box.x_px; x < box.x_px + box.width_px; ++x) {
        EXPECT_EQ(is_left(x, y)++, 0);
        ++result.left;
      }
  }
  for (int y = 0; y < scores.height(); ++y)
    for (int x = 0; x < scores.width(); ++x) {
      EXPECT_EQ(is_left(x, y) != 0, scores(x, y) == kUnwritten) << x << " " << y;
      if (is_left(x, y) != 0 || (2 * x + y) % 5 != 0) continue;
      const double wanted = oracle::ncc_at(host.samples, host.image, x + host.job.x_px,
                                           y + host.job.y_px, host.shape, host.weights)
                                .value_or(-2);
      result.worst = std::max(result.worst, std::abs(wanted - scores(x, y)));
    }
  return result;
}

FloatImage to_float(const GreyImage& grey, float scale, float offset) {
  FloatImage image(grey.width(), grey.height());
  for (std::size_t i = 0; i < grey.size(); ++i)
    image.data()[i] = scale * (static_cast<float>(grey.data()[i]) + 0.25F) + offset;
  return image;
}

TEST(NccFrequency, AgreesWithTheOracle) {
  for (const auto& [name, image] : test_images(170, 111))
    for (const auto& [width, height, gaussian] :
         {std::tuple{31, 31, false}, {11, 11, false}, {25, 7, true}, {3, 31, false}}) {
      const HostJob host(image, width, height, gaussian);
      const Outcome result = outcome(host);
      EXPECT_LT(result.worst, 1e-4) << name << " " << width << "x" << height;
      if (name == "natural" || name == "noise") {
        EXPECT_EQ(result.left, 0U) << name << " " << width << "x" << height;
      }
    }
}

TEST(NccFrequency, FloatImagesOfAnyRangeAgreeWithTheOracle) {
  const GreyImage grey = test_images(170, 111)[0].second;
  for (const auto& [scale, offset] : {std::pair{1.F, 0.F},
                                      {1 / 255.F, 0.F},
                                      {1e-3F, -7.F},
                                      {3e4F, 1e5F},
                                      {1e-12F, 0.F},
                                      {1e12F, 0.F}})
    for (const bool gaussian : {false, true}) {
      const Outcome result = outcome(HostJob(to_float(grey, scale, offset), 21, 31, gaussian));
      EXPECT_LT(result.worst, 1e-4) << scale << gaussian;
      EXPECT_EQ(result.left, 0U) << scale << gaussian;
    }
}

// A faint texture beside one that is far stronger: what rounding would spoil is left.
TEST(NccFrequency, WhatRoundingWouldSpoilIsLeft) {
  const Texture texture(0.2, 8);
  std::size_t left = 0, all = 0;
  for (const double faint : {1., 0.1, 1e-2, 1e-3, 1e-4}) {
    FloatImage image(300, 120);
    for (int y = 0; y < 120; ++y)
      for (int x = 0; x < 300; ++x)
        image(x, y) = static_cast<float>((x < 130 ? faint : 1.) * texture(x, y));
    for (const int x : {40, 220}) {
      const HostJob host(image, 15, 15, false, x, 60);
      const Outcome result = outcome(host);
      EXPECT_LT(result.worst, 1e-4) << faint;
      left += result.left;
      all += static_cast<std::size_t>(host.job.width_px * host.job.height_px);
      if (faint == 1) {
        EXPECT_EQ(result.left, 0U);
      }
    }
  }
  EXPECT_GT(left, 0U);
  EXPECT_LT(left, all / 2);
}

TEST(NccFrequency, BlocksWithPixelsThatAreNotFiniteAreLeft) {
  const GreyImage grey = test_images(400, 131)[0].second;
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), -std::numeric_limits<float>::infinity(), 3e38F}) {
    FloatImage image = to_float(grey, 1, 0);
    HostJob host(image, 31, 31, false);
    const FloatImage* before = &host.image;
    ASSERT_EQ(outcome(host).left, 0U);
    ASSERT_EQ(before, &host.image);
    host.image(350, 66) = bad;
    host.image(0, 0) = bad;
    FloatImage scores(host.job.width_px, host.job.height_px, kUnwritten);
    Image<std::uint8_t> is_left(host.job.width_px, host.job.height_px, 0);
    std::size_t left = 0;
    for (const CandidateBox& box : score_by_frequency(host.job, scores.data()))
      for (int y = box.y_px; y < box.y_px + box.height_px; ++y)
        for (int x = box.x_px; x < box.x_px + box.width_px; ++x) {
          is_left(x, y) = 1;
          ++left;
        }
    EXPECT_LT(left, scores.size());
    // All footprints that hold one are left; the others are right.
    for (int y = 0; y < scores.height(); ++y)
      for (int x = 0; x < scores.width(); ++x) {
        if ((x <= 350 && x > 350 - 31 && y <= 66 && y > 66 - 31) || (x == 0 && y == 0)) {
          ASSERT_EQ(is_left(x, y), 1);
        }
        ASSERT_EQ(is_left(x, y) != 0, scores(x, y) == kUnwritten);
        if (is_left(x, y) == 0 && (x * 7 + y) % 13 == 0) {
          ASSERT_NEAR(
              scores(x, y),
              *oracle::ncc_at(host.samples, host.image, x + 15, y + 15, host.shape, host.weights),
              1e-4);
        }
      }
  }
}

TEST(NccFrequency, WindowsOfEverySizeAndAnyNumberOfThreads) {
  HostJob host(test_images(420, 300)[0].second, 31, 17, false);
  FloatImage whole(host.job.width_px, host.job.height_px, kUnwritten);
  ASSERT_TRUE(score_by_frequency(host.job, whole.data()).empty());
  host.job.threads = 1;
  FloatImage again(host.job.width_px, host.job.height_px, kUnwritten);
  ASSERT_TRUE(score_by_frequency(host.job, again.data()).empty());
  EXPECT_EQ(whole, again);
  for (const auto& [x, y, width, height] : {std::array{0, 0, 1, 1},
                                            {389, 283, 1, 1},
                                            {5, 7, 300, 2},
                                            {200, 3, 3, 280},
                                            {17, 20, 129, 131}}) {
    FrequencyJob part = host.job;
    part.x_px += x;
    part.y_px += y;
    part.width_px = width;
    part.height_px = height;
    FloatImage scores(width, height, kUnwritten);
    ASSERT_TRUE(score_by_frequency(part, scores.data()).empty());
    for (int j = 0; j < height; ++j)
      for (int i = 0; i < width; ++i) ASSERT_NEAR(scores(i, j), whole(x + i, y + j), 5e-5);
  }
  host.job.width_px = 0;
  EXPECT_TRUE(score_by_frequency(host.job, nullptr).empty());
}

TEST(NccFrequency, APlantedFaultIsFound) {
  HostJob host(test_images(170, 111)[0].second, 31, 31, false);
  EXPECT_LT(outcome(host).worst, 1e-4);
  host.taps[15 * 31 + 16] = 0;
  EXPECT_GT(outcome(host).worst, 5e-4);
}

}  // namespace
}  // namespace corvid
