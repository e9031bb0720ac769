#include "kernels/filter.h"

#include <gtest/gtest.h>

#include <limits>

#include "kernels/test_device.h"
#include "kernels/textures.h"
#include "oracle/filter.h"

namespace corvid {
namespace {

constexpr KernelKind kKinds[] = {KernelKind::cpu, KernelKind::gpu};

// What rounding allows: to the nearest grey level, and that of single precision.
constexpr double kGreyRounding = 0.5 + 2e-4, kFloatRounding = 2e-4;

GaussianFilter make_filter(double sigma_px, PixelFormat format, KernelKind kind,
                           const char* options = "") {
  return make<GaussianFilter>(sigma_px, options, format, kind);
}

GreyImage filtered(GaussianFilter& filter, const GreyImage& image) {
  return download(*test_device(), filter.filter(upload(*test_device(), image)));
}
FloatImage filtered(GaussianFilter& filter, const FloatImage& image) {
  return download_float(*test_device(), filter.filter(upload(*test_device(), image)));
}

// The same grey levels, moved and scaled so that they are no integers.
FloatImage as_float(const GreyImage& image) {
  FloatImage out(image.width(), image.height());
  for (std::size_t i = 0; i < out.size(); ++i)
    out.data()[i] = 0.37F * static_cast<float>(image.data()[i]) - 20;
  return out;
}

// Largest difference to the oracle at every `step`-th pixel and in the corners.
template <class Pixel>
double worst_difference(GaussianFilter& filter, const Image<Pixel>& image, double sigma_px,
                        int step = 1) {
  const Image<Pixel> got = filtered(filter, image);
  EXPECT_EQ(got.width(), image.width());
  EXPECT_EQ(got.height(), image.height());
  double worst = 0;
  const auto compare = [&](int x, int y) {
    worst = std::max(worst, std::abs(oracle::gaussian(image, sigma_px, x, y) - got(x, y)));
  };
  const int width = image.width(), height = image.height();
  for (int i = 0; i < width * height; i += step) compare(i % width, i / width);
  for (const int x : {0, width - 1})
    for (const int y : {0, height - 1}) compare(x, y);
  return worst;
}

TEST(GaussianFilter, AgreesWithTheOracle) {
  for (const KernelKind kind : kKinds)
    for (const double sigma : {0.3, 0.8, 1.5, 3.3, 10.}) {
      auto grey = make_filter(sigma, PixelFormat::grey8, kind);
      auto floats = make_filter(sigma, PixelFormat::float32, kind);
      const int step = sigma < 1 ? 1 : 41;  // the oracle is slow
      for (const auto& [width, height] : {std::pair{133, 67}, {40, 90}, {257, 33}})
        for (const auto& [name, image] : test_images(width, height)) {
          EXPECT_LE(worst_difference(grey, image, sigma, step), kGreyRounding)
              << name << " " << width << " " << sigma;
          EXPECT_LE(worst_difference(floats, as_float(image), sigma, step), kFloatRounding)
              << name << " " << width << " " << sigma;
        }
    }
}

TEST(GaussianFilter, ImagesOfAnySizeAgree) {
  for (const KernelKind kind : kKinds)
    for (const double sigma : {0.6, 10.}) {
      auto grey = make_filter(sigma, PixelFormat::grey8, kind);
      auto floats = make_filter(sigma, PixelFormat::float32, kind);
      for (const auto& [width, height] :
           {std::pair{1, 1}, {1, 50}, {50, 1}, {2, 2}, {15, 3}, {16, 2}, {17, 5}, {31, 100}}) {
        const GreyImage image = noise(width, height);
        EXPECT_LE(worst_difference(grey, image, sigma), kGreyRounding) << width << " x " << height;
        EXPECT_LE(worst_difference(floats, as_float(image), sigma), kFloatRounding)
            << width << " x " << height;
      }
    }
}

// Wider than the tile of a work-group, with the last tile narrower than the window.
TEST(GaussianFilter, TilesJoinWithoutSeams) {
  for (const KernelKind kind : kKinds)
    for (const int width : {1023, 1024, 1025, 1041, 2053}) {
      auto grey = make_filter(4, PixelFormat::grey8, kind);
      auto floats = make_filter(4, PixelFormat::float32, kind);
      const GreyImage image = noise(width, 9);
      EXPECT_LE(worst_difference(grey, image, 4, 3), kGreyRounding) << width;
      EXPECT_LE(worst_difference(floats, as_float(image), 4, 3), kFloatRounding) << width;
    }
}

TEST(GaussianFilter, ConstantImagesStay) {
  for (const KernelKind kind : kKinds)
    for (const double sigma : {0.3, 1., 9.7})
      for (const int grey : {0, 1, 128, 254, 255}) {
        auto filter = make_filter(sigma, PixelFormat::grey8, kind);
        const GreyImage image(90, 40, static_cast<std::uint8_t>(grey));
        EXPECT_EQ(filtered(filter, image), image) << sigma;
      }
}

TEST(GaussianFilter, APlantedFaultIsFound) {
  for (const KernelKind kind : kKinds) {
    auto grey = make_filter(1.2, PixelFormat::grey8, kind, "-DCORVID_PLANT_FAULT");
    auto floats = make_filter(1.2, PixelFormat::float32, kind, "-DCORVID_PLANT_FAULT");
    for (const auto& [name, image] : test_images(133, 67)) {
      EXPECT_GT(worst_difference(grey, image, 1.2), kGreyRounding) << name;
      EXPECT_GT(worst_difference(floats, as_float(image), 1.2), kFloatRounding) << name;
    }
  }
}

TEST(GaussianFilter, TheWindowIsWideEnough) {
  // An impulse spreads as the Gaussian does: nearly the same variance, and nothing is lost.
  auto filter = make_filter(2.5, PixelFormat::float32, KernelKind::suited);
  FloatImage impulse(101, 101);
  impulse(50, 50) = 1000;
  const FloatImage spread = filtered(filter, impulse);
  double sum = 0, variance = 0;
  for (int y = 0; y < 101; ++y)
    for (int x = 0; x < 101; ++x) {
      sum += spread(x, y);
      variance += spread(x, y) * (x - 50.) * (x - 50.);
    }
  EXPECT_NEAR(sum, 1000, 1e-2);
  EXPECT_NEAR(variance / sum, 2.5 * 2.5, 0.02);
}

TEST(GaussianFilter, RefusesWhatItCannotDo) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const double sigma : {0., -1., 0.29, 10.1, 1e300, nan, -nan, HUGE_VAL}) {
    const auto filter = GaussianFilter::create(test_device(), sigma);
    ASSERT_FALSE(filter) << sigma;
    EXPECT_EQ(filter.error().code, ErrorCode::invalid_argument);
  }
  auto grey = make<GaussianFilter>(1.);
  EXPECT_THROW((void)grey.filter(upload(*test_device(), FloatImage(20, 20))), std::logic_error);
}

}  // namespace
}  // namespace corvid
