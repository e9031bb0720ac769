#include "kernels/pyramid.h"

#include <gtest/gtest.h>

#include "kernels/test_device.h"
#include "kernels/textures.h"
#include "oracle/pyramid.h"

namespace corvid {
namespace {

// Largest difference to the oracle, over all levels; rounding alone makes 0.5.
double worst_difference(PyramidBuilder& builder, const GreyImage& image, int levels) {
  const auto pyramid = builder.build(image, levels);
  double worst = 0;
  GreyImage above = image;
  for (int i = 0; i < pyramid->levels(); ++i) {
    const GreyImage level = download(*test_device(), pyramid->level(i));
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

TEST(Pyramid, AgreesWithTheOracle) {
  auto builder = make<PyramidBuilder>();
  for (const auto& [width, height] : {std::pair{160, 120}, {97, 61}, {33, 200}, {131, 32}})
    for (const auto& [name, image] : test_images(width, height))
      EXPECT_LE(worst_difference(builder, image, 4), 0.5) << name << " " << width;
}

TEST(Pyramid, APlantedFaultIsFound) {
  auto builder = make<PyramidBuilder>("-DCORVID_PLANT_FAULT");
  for (const auto& [name, image] : test_images(160, 120))
    EXPECT_GT(worst_difference(builder, image, 2), 0.5) << name;
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
