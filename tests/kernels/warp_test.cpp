#include "kernels/warp.h"

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "kernels/test_device.h"
#include "kernels/textures.h"
#include "oracle/warp.h"

namespace corvid {
namespace {

Camera radtan(int width, int height) {
  Camera camera;
  camera.model = CameraModel::radtan;
  camera.width_px = width;
  camera.height_px = height;
  camera.fx_px = 0.8 * width;
  camera.fy_px = 0.82 * width;
  camera.cx_px = 0.51 * width;
  camera.cy_px = 0.49 * height;
  camera.distortion = {-0.28, 0.07, 0.0002, 0.00002, 0};
  return camera;
}

WarpMap undistort_and_turn(const Camera& camera) {
  const Eigen::Matrix3d R =
      Eigen::AngleAxisd(0.1, Eigen::Vector3d(0.3, 1, 0.5).normalized()).toRotationMatrix();
  return WarpMap::between(camera, camera.undistorted(), R);
}

// Largest difference to the oracle at the map's points, before rounding.
double worst_difference(const GreyImage& source, const WarpMap& map, const GreyImage& warped) {
  double worst = 0;
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const auto p = map.points()(x, y);
      const double wanted = oracle::bilinear(source, p.x_px, p.y_px).value_or(0);
      worst = std::max(worst, std::abs(wanted - warped(x, y)));
    }
  return worst;
}

GreyImage warp_on_device(Warper& warper, const GreyImage& source, const WarpMap& map) {
  return download(*test_device(), warper.remap(upload(*test_device(), source), warper.upload(map)));
}

TEST(Warp, AgreesWithTheOracle) {
  auto warper = make<Warper>();
  const WarpMap map = undistort_and_turn(radtan(157, 101));
  for (const auto& [name, image] : test_images(157, 101)) {
    EXPECT_LE(worst_difference(image, map, warp_on_device(warper, image, map)), 0.501) << name;
    EXPECT_LE(worst_difference(image, map, remap(image, map)), 0.501) << name;
  }
}

TEST(Warp, APlantedFaultIsFound) {
  auto warper = make<Warper>("-DCORVID_PLANT_FAULT");
  const WarpMap map = undistort_and_turn(radtan(157, 101));
  const GreyImage image = test_images(157, 101)[0].second;
  EXPECT_GT(worst_difference(image, map, warp_on_device(warper, image, map)), 0.501);
}

TEST(Warp, BetweenFollowsTheCameras) {
  const Camera camera = radtan(160, 120), pinhole = camera.undistorted();
  const Eigen::Matrix3d R = Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitY()).toRotationMatrix();
  const WarpMap map = WarpMap::between(camera, pinhole, R);
  EXPECT_EQ(map.width(), pinhole.width_px);
  EXPECT_EQ(map.height(), pinhole.height_px);
  int seen = 0;
  for (const int x : {10, 80, 150})
    for (const int y : {5, 60, 110}) {
      // From the first principles: a far point on the ray, seen by the other camera.
      const Eigen::Vector3d point(100 * (x - pinhole.cx_px) / pinhole.fx_px,
                                  100 * (y - pinhole.cy_px) / pinhole.fy_px, 100);
      const auto pixel = camera.project(R * point);
      if (!pixel) continue;
      ++seen;
      EXPECT_NEAR(map.points()(x, y).x_px, pixel->x(), 1e-3);
      EXPECT_NEAR(map.points()(x, y).y_px, pixel->y(), 1e-3);
    }
  EXPECT_GE(seen, 6);
}

TEST(Warp, BehindTheCameraIsOutside) {
  const Camera pinhole = radtan(64, 48).undistorted();
  const Eigen::Matrix3d back =
      Eigen::AngleAxisd(3.14159, Eigen::Vector3d::UnitY()).toRotationMatrix();
  const WarpMap map = WarpMap::between(pinhole, pinhole, back);
  for (int x = 0; x < map.width(); ++x) EXPECT_EQ(map.points()(x, 20), WarpMap::Point{});
  EXPECT_EQ(remap(GreyImage(64, 48, 200), map), GreyImage(map.width(), map.height(), 0));
}

TEST(Warp, HomographyOfIntegerShiftCopies) {
  auto warper = make<Warper>();
  Eigen::Matrix3d H = Eigen::Matrix3d::Identity();
  H(0, 2) = 7;
  H(1, 2) = -5;
  const GreyImage image = noise(90, 70);
  const WarpMap map = WarpMap::homography(H, 90, 70);
  const GreyImage wanted = paint(
      90, 70, [&](int x, int y) { return image.contains(x + 7, y - 5) ? image(x + 7, y - 5) : 0; });
  EXPECT_EQ(warp_on_device(warper, image, map), wanted);
  EXPECT_EQ(remap(image, map), wanted);
  const GreyImage valid = map.valid(90, 70);
  for (int y = 0; y < 70; ++y)
    for (int x = 0; x < 90; ++x) EXPECT_EQ(valid(x, y) == 255, image.contains(x + 7, y - 5));
}

TEST(Warp, HomographyAtTheHorizonIsOutside) {
  Eigen::Matrix3d H = Eigen::Matrix3d::Identity();
  H(2, 0) = -1. / 30;  // z = 0 at x = 30
  const WarpMap map = WarpMap::homography(H, 60, 10);
  for (int x = 30; x < 60; ++x) EXPECT_EQ(map.points()(x, 5), WarpMap::Point{});
  for (int x = 0; x < 60; ++x) EXPECT_TRUE(std::isfinite(map.points()(x, 5).x_px));
}

TEST(Warp, ChannelsAreWarpedAlike) {
  const GreyImage grey = test_images(80, 60)[0].second;
  ColourImage colour(80, 60);
  FloatImage floats(80, 60);
  for (std::size_t i = 0; i < grey.size(); ++i) {
    const std::uint8_t v = grey.data()[i];
    colour.data()[i] = {v, static_cast<std::uint8_t>(255 - v), 7};
    floats.data()[i] = v;
  }
  const WarpMap map = undistort_and_turn(radtan(80, 60));
  const GreyImage g = remap(grey, map);
  const ColourImage c = remap(colour, map);
  const FloatImage f = remap(floats, map);
  const GreyImage valid = map.valid(80, 60);
  int inside = 0;
  for (std::size_t i = 0; i < g.size(); ++i) {
    EXPECT_EQ(c.data()[i].r, g.data()[i]);
    EXPECT_LE(std::abs(f.data()[i] - g.data()[i]), 0.5F);
    if (valid.data()[i] == 0) {
      EXPECT_EQ(c.data()[i], Rgb8{});
      continue;
    }
    ++inside;
    EXPECT_LE(std::abs(255 - c.data()[i].g - g.data()[i]), 1);
    EXPECT_EQ(c.data()[i].b, 7);
  }
  EXPECT_GT(inside, 2000);
}

}  // namespace
}  // namespace corvid
