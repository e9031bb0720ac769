#include "kernels/pyramid.h"

#include <gtest/gtest.h>

#include "kernels/test_device.h"
#include "kernels/textures.h"
#include "oracle/pyramid.h"

namespace corvid {
namespace {

constexpr KernelKind kKinds[] = {KernelKind::cpu, KernelKind::gpu};

PyramidBuilder make_builder(KernelKind kind, PixelFormat format = PixelFormat::grey8,
                            const char* options = "") {
  return make<PyramidBuilder>(options, format, kind);
}

GreyImage pixels(const DeviceImage& image, std::uint8_t) { return download(*test_device(), image); }
FloatImage pixels(const DeviceImage& image, float) { return download_float(*test_device(), image); }

// Largest difference to the oracle, over all levels; rounding alone makes 0.5 of 8-bit ones.
template <class Pixel>
double worst_difference(PyramidBuilder& builder, const Image<Pixel>& image, int levels) {
  const auto pyramid = builder.build(upload(*test_device(), image), levels);
  double worst = 0;
  Image<Pixel> above = image;
  for (int i = 0; i < pyramid->levels(); ++i) {
    const Image<Pixel> level = pixels(pyramid->level(i), Pixel{});
    if (i == 0) {
      EXPECT_EQ(level, image);
      continue;
    }
    const Image<double> wanted = oracle::halve(above);
    EXPECT_EQ(level.width(), wanted.width());
    EXPECT_EQ(level.height(), wanted.height());
    for (std::size_t k = 0; k < wanted.size(); ++k)
      worst = std::max(worst, std::abs(level.data()[k] - wanted.data()[k]));
    above = level;
  }
  return worst;
}

// The same grey levels, moved and scaled so that they are no integers.
FloatImage as_float(const GreyImage& image) {
  FloatImage out(image.width(), image.height());
  for (std::size_t i = 0; i < out.size(); ++i)
    out.data()[i] = 0.37F * static_cast<float>(image.data()[i]) - 20;
  return out;
}

TEST(Pyramid, AgreesWithTheOracle) {
  for (const KernelKind kind : kKinds) {
    auto builder = make_builder(kind), floats = make_builder(kind, PixelFormat::float32);
    for (const auto& [width, height] :
         {std::pair{160, 120}, {97, 61}, {33, 200}, {131, 32}, {32, 31}, {31, 33}})
      for (const auto& [name, image] : test_images(width, height)) {
        EXPECT_LE(worst_difference(builder, image, 4), 0.5) << name << " " << width;
        EXPECT_LE(worst_difference(floats, as_float(image), 4), 2e-5) << name << " " << width;
      }
  }
}

TEST(Pyramid, EveryWidthAndHeightAgrees) {
  auto builder = make_builder(KernelKind::cpu);
  auto floats = make_builder(KernelKind::cpu, PixelFormat::float32);
  const GreyImage all = noise(200, 100);
  for (int width = 31; width <= 200; ++width) {
    const int height = 31 + width % 66;  // among them one band and several
    const GreyImage image = paint(width, height, [&](int x, int y) { return all(x, y); });
    EXPECT_LE(worst_difference(builder, image, 2), 0.5) << width << " x " << height;
    EXPECT_LE(worst_difference(floats, as_float(image), 2), 2e-5) << width << " x " << height;
  }
}

TEST(Pyramid, WhiteDoesNotOverflow) {
  for (const KernelKind kind : kKinds) {
    auto builder = make_builder(kind);
    const auto pyramid = builder.build(GreyImage(300, 203, 255), 3);
    for (int i = 0; i < 3; ++i) {
      const DeviceImage& level = pyramid->level(i);
      EXPECT_EQ(download(*test_device(), level), GreyImage(level.width_px, level.height_px, 255));
    }
  }
}

TEST(Pyramid, APlantedFaultIsFound) {
  for (const KernelKind kind : kKinds) {
    auto builder = make_builder(kind, PixelFormat::grey8, "-DCORVID_PLANT_FAULT");
    auto floats = make_builder(kind, PixelFormat::float32, "-DCORVID_PLANT_FAULT");
    for (const auto& [name, image] : test_images(160, 120)) {
      EXPECT_GT(worst_difference(builder, image, 2), 0.5) << name;
      EXPECT_GT(worst_difference(floats, as_float(image), 2), 2e-5) << name;
    }
  }
}

// One band ends where the next begins, at whatever speed the two are made.
TEST(Pyramid, BandsDoNotTouchEachOther) {
  auto builder = make_builder(KernelKind::cpu);
  auto by_pixel = make_builder(KernelKind::gpu);
  const GreyImage image = noise(801, 733);
  const auto wanted = by_pixel.build(image, 4);
  for (int run = 0; run < 10; ++run) {
    const auto pyramid = builder.build(image, 4);
    for (int i = 1; i < 4; ++i)
      EXPECT_EQ(download(*test_device(), pyramid->level(i)),
                download(*test_device(), wanted->level(i)));
  }
}

TEST(Pyramid, ImagesAreCopiedBackInTheirFormat) {
  const DeviceImage grey = upload(*test_device(), GreyImage(20, 20, 3));
  const DeviceImage floats = upload(*test_device(), FloatImage(20, 20, 2.5F));
  EXPECT_EQ(download_float(*test_device(), floats), FloatImage(20, 20, 2.5F));
  EXPECT_THROW((void)download(*test_device(), floats), std::logic_error);
  EXPECT_THROW((void)download_float(*test_device(), grey), std::logic_error);
}

TEST(Pyramid, LevelsHalveAndStopInTime) {
  auto builder = make<PyramidBuilder>();
  const auto pyramid = builder.build(GreyImage(101, 64, 3), 9);
  ASSERT_EQ(pyramid->levels(), 3);
  EXPECT_EQ(pyramid->level(1).width_px, 51);
  EXPECT_EQ(pyramid->level(2).width_px, 26);
  EXPECT_EQ(pyramid->level(2).height_px, 16);
  EXPECT_THROW((void)pyramid->level(3), std::logic_error);
  EXPECT_THROW((void)builder.build(GreyImage(64, 64), 0), std::logic_error);
  EXPECT_THROW((void)builder.build(GreyImage(), 2), std::logic_error);
  const DeviceImage floats = upload(*test_device(), FloatImage(40, 40));
  EXPECT_THROW((void)builder.build(floats, 2), std::logic_error);
  EXPECT_EQ(builder.build(GreyImage(1, 1, 5), 3)->levels(), 1);
}

TEST(Pyramid, PixelsKeepTheirPlace) {
  auto builder = make<PyramidBuilder>();
  // A bright blob centred at pixel (64, 40) is centred at (16, 10) two levels down.
  const GreyImage image = paint(128, 96, [](int x, int y) {
    return 250 * std::exp(-((x - 64) * (x - 64) + (y - 40) * (y - 40)) / 60.);
  });
  const GreyImage level = download(*test_device(), builder.build(image, 3)->level(2));
  double sum = 0, sx = 0, sy = 0;
  for (int y = 0; y < level.height(); ++y)
    for (int x = 0; x < level.width(); ++x) {
      sum += level(x, y);
      sx += x * level(x, y);
      sy += y * level(x, y);
    }
  EXPECT_NEAR(sx / sum, 16, 0.01);
  EXPECT_NEAR(sy / sum, 10, 0.01);
}

}  // namespace
}  // namespace corvid
