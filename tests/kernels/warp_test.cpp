#include "kernels/warp.h"

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <limits>

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

constexpr KernelKind kKinds[] = {KernelKind::cpu, KernelKind::gpu};

Warper make_warper(KernelKind kind, PixelFormat format = PixelFormat::grey8,
                   const char* options = "") {
  return make<Warper>(options, format, kind);
}

GreyImage to_host(const DeviceImage& image, std::uint8_t) {
  return download(*test_device(), image);
}
FloatImage to_host(const DeviceImage& image, float) {
  return download_float(*test_device(), image);
}

// The same grey levels, moved and scaled so that they are no integers.
FloatImage as_float(const GreyImage& image) {
  FloatImage out(image.width(), image.height());
  for (std::size_t i = 0; i < out.size(); ++i)
    out.data()[i] = 0.37F * static_cast<float>(image.data()[i]) - 20;
  return out;
}

// Largest difference to the oracle at the map's points, before rounding.
template <class Pixel>
double worst_difference(const Image<Pixel>& source, const WarpMap& map,
                        const Image<Pixel>& warped) {
  double worst = 0;
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const auto p = map.points()(x, y);
      const double wanted = oracle::bilinear(source, p.x_px, p.y_px).value_or(0);
      worst = std::max(worst, std::abs(wanted - warped(x, y)));
    }
  return worst;
}

template <class Pixel>
Image<Pixel> warp_on_device(Warper& warper, const Image<Pixel>& source, const WarpMap& map) {
  return to_host(warper.remap(upload(*test_device(), source), warper.upload(map)), Pixel{});
}

TEST(Warp, AgreesWithTheOracle) {
  for (const KernelKind kind : kKinds) {
    auto grey = make_warper(kind), floats = make_warper(kind, PixelFormat::float32);
    for (const auto& [width, height] : {std::pair{157, 101}, {64, 48}, {19, 33}}) {
      const WarpMap map = undistort_and_turn(radtan(width, height));
      for (const auto& [name, image] : test_images(width, height)) {
        EXPECT_LE(worst_difference(image, map, warp_on_device(grey, image, map)), 0.501) << name;
        EXPECT_LE(worst_difference(image, map, remap(image, map)), 0.501) << name;
        const FloatImage other = as_float(image);
        EXPECT_LE(worst_difference(other, map, warp_on_device(floats, other, map)), 1e-4) << name;
        EXPECT_LE(worst_difference(other, map, remap(other, map)), 1e-4) << name;
      }
    }
  }
}

TEST(Warp, APlantedFaultIsFound) {
  for (const KernelKind kind : kKinds) {
    auto grey = make_warper(kind, PixelFormat::grey8, "-DCORVID_PLANT_FAULT");
    auto floats = make_warper(kind, PixelFormat::float32, "-DCORVID_PLANT_FAULT");
    const WarpMap map = undistort_and_turn(radtan(157, 101));
    const GreyImage image = test_images(157, 101)[0].second;
    EXPECT_GT(worst_difference(image, map, warp_on_device(grey, image, map)), 0.501);
    const FloatImage other = as_float(image);
    EXPECT_GT(worst_difference(other, map, warp_on_device(floats, other, map)), 1e-4);
  }
}

// The places that a homography names, in double precision.
struct Place {
  double x = -1, y = -1;
};
Place place(const Eigen::Matrix3d& H, int x, int y) {
  const Eigen::Vector3d p = H * Eigen::Vector3d(x, y, 1);
  return p.z() > 0 ? Place{p.x() / p.z(), p.y() / p.z()} : Place{};
}

// Counts the pixels that differ from the oracle by more than a place off by 1e-3 px makes (less at
// the image's border, where that decides between a value and none), and those with a value.
template <class Pixel>
std::pair<int, int> wrong_and_seen(const Image<Pixel>& source, const Eigen::Matrix3d& H,
                                   const Image<Pixel>& warped, double rounding) {
  int wrong = 0, seen = 0;
  constexpr double kSlack = 1e-3;
  for (int y = 0; y < warped.height(); ++y)
    for (int x = 0; x < warped.width(); ++x) {
      const Place p = place(H, x, y);
      const auto wanted = oracle::bilinear(source, p.x, p.y);
      const bool at_border =
          source.contains(p.x, p.y, -kSlack) != source.contains(p.x, p.y, kSlack);
      seen += wanted.has_value();
      const double difference = std::abs(wanted.value_or(0) - warped(x, y));
      wrong += difference > rounding && !at_border;
    }
  return {wrong, seen};
}

std::vector<std::pair<std::string, Eigen::Matrix3d>> homographies() {
  Eigen::Matrix3d mild, horizon, mirrored, turned, tiny;
  mild << 1.02, 0.03, -4, -0.02, 0.98, 5, 1e-4, -2e-4, 1;
  horizon << 1, 0.2, -3, 0.1, 1, 2, -1. / 80, 1e-3, 1;  // the horizon crosses the image
  mirrored << -1, 0, 150, 0, 1, 0, 1. / 300, 0, 1;
  turned << 0.1, -1, 100, 1, 0.1, 2, 0, 0, 1;
  tiny = 1e-9 * mild;
  return {{"mild", mild},
          {"horizon", horizon},
          {"mirrored", mirrored},
          {"turned", turned},
          {"of another scale", tiny}};
}

TEST(Warp, HomographiesOnTheDeviceAgreeWithTheOracle) {
  for (const KernelKind kind : kKinds) {
    auto grey = make_warper(kind), floats = make_warper(kind, PixelFormat::float32);
    for (const auto& [name, H] : homographies())
      for (const auto& [width, height] : {std::pair{157, 101}, {80, 120}, {15, 15}})
        for (const auto& [kind_of, image] : test_images(157, 101)) {
          const DeviceImage source = upload(*test_device(), image);
          const GreyImage warped = to_host(grey.warp(source, H, width, height), std::uint8_t{});
          // Neighbours differ by 255 at most, places by 1e-4 px.
          const auto [wrong, seen] = wrong_and_seen(image, H, warped, 0.5 + 0.03);
          EXPECT_EQ(wrong, 0) << name << ", " << kind_of << ", " << width;
          EXPECT_GT(seen, width * height / 5) << name;
          const FloatImage other = as_float(image);
          const FloatImage out =
              to_host(floats.warp(upload(*test_device(), other), H, width, height), 0.F);
          EXPECT_EQ(wrong_and_seen(other, H, out, 0.01).first, 0) << name << ", " << kind_of;
        }
  }
}

TEST(Warp, AFaultPlantedInHomographiesIsFound) {
  for (const KernelKind kind : kKinds) {
    auto warper = make_warper(kind, PixelFormat::grey8, "-DCORVID_PLANT_FAULT");
    const GreyImage image = test_images(157, 101)[0].second;
    for (const auto& [name, H] : homographies()) {
      const GreyImage warped =
          to_host(warper.warp(upload(*test_device(), image), H, 157, 101), std::uint8_t{});
      EXPECT_GT(wrong_and_seen(image, H, warped, 0.5 + 0.03).first, 1000) << name;
    }
  }
}

// Far from the origin, where single precision would lose the place.
TEST(Warp, HomographiesKeepTheirPlaceInLargeImages) {
  for (const KernelKind kind : kKinds) {
    auto warper = make_warper(kind, PixelFormat::float32);
    FloatImage ramp(3000, 40);
    for (int y = 0; y < 40; ++y)
      for (int x = 0; x < 3000; ++x) ramp(x, y) = static_cast<float>(x) - 1500;
    Eigen::Matrix3d H = Eigen::Matrix3d::Identity();
    H << 1.01, 0, -1e4 + 0.25, 0, 1, 0, 1e-3, 0, 7;  // cancels: x of about 1e4 less 1e4
    H.row(0) += 5 * H.row(2);
    const FloatImage out = to_host(warper.warp(upload(*test_device(), ramp), H, 12000, 40), 0.F);
    int seen = 0;
    for (int x = 0; x < 12000; ++x) {
      const Place p = place(H, x, 20);
      if (!ramp.contains(p.x, p.y, 1)) continue;
      ++seen;
      EXPECT_NEAR(out(x, 20), p.x - 1500, 2e-3) << x;
    }
    EXPECT_GT(seen, 1000);
  }
}

TEST(Warp, HostileHomographiesAreOutside) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  for (const KernelKind kind : kKinds) {
    auto warper = make_warper(kind);
    const DeviceImage image = upload(*test_device(), GreyImage(40, 30, 200));
    for (const double value : {nan, inf, -inf}) {
      const Eigen::Matrix3d H = Eigen::Matrix3d::Constant(value);
      EXPECT_EQ(to_host(warper.warp(image, H, 50, 20), std::uint8_t{}), GreyImage(50, 20));
    }
    const Eigen::Matrix3d zero = Eigen::Matrix3d::Zero(), behind = -Eigen::Matrix3d::Identity();
    EXPECT_EQ(to_host(warper.warp(image, zero, 50, 20), std::uint8_t{}), GreyImage(50, 20));
    EXPECT_EQ(to_host(warper.warp(image, behind, 50, 20), std::uint8_t{}), GreyImage(50, 20));
    const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
    EXPECT_THROW((void)warper.warp(image, I, 0, 20), std::logic_error);
    EXPECT_THROW((void)warper.warp(upload(*test_device(), FloatImage(9, 9)), I, 9, 9),
                 std::logic_error);
  }
}

// The last row and column are read whole: what lies past the image does not matter.
TEST(Warp, IdentityCopies) {
  for (const KernelKind kind : kKinds) {
    auto grey = make_warper(kind), floats = make_warper(kind, PixelFormat::float32);
    const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
    for (const auto& [width, height] : {std::pair{1, 1}, {1, 7}, {7, 1}, {16, 3}, {35, 20}}) {
      const GreyImage image = noise(width, height);
      const FloatImage other = as_float(image);
      const WarpMap map = WarpMap::homography(I, width, height);
      const DeviceImage g = upload(*test_device(), image), f = upload(*test_device(), other);
      EXPECT_EQ(to_host(grey.warp(g, I, width, height), std::uint8_t{}), image);
      EXPECT_EQ(to_host(floats.warp(f, I, width, height), 0.F), other);
      EXPECT_EQ(warp_on_device(grey, image, map), image);
      EXPECT_EQ(warp_on_device(floats, other, map), other);
    }
  }
}

TEST(Warp, PinholesAreRelatedByAHomography) {
  Camera from = radtan(160, 120).undistorted(), to = from;
  to.fx_px *= 1.1;
  to.cx_px -= 7;
  const Eigen::Matrix3d R =
      Eigen::AngleAxisd(0.15, Eigen::Vector3d(0.3, 1, 0.2).normalized()).toRotationMatrix();
  const WarpMap map = WarpMap::between(from, to, R);
  const Eigen::Matrix3d H = homography_between(from, to, R);
  int seen = 0;
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 160; ++x) {
      const auto p = map.points()(x, y);
      if (p == WarpMap::Point{}) continue;
      ++seen;
      EXPECT_NEAR(place(H, x, y).x, p.x_px, 1e-3);
      EXPECT_NEAR(place(H, x, y).y, p.y_px, 1e-3);
    }
  EXPECT_GT(seen, 10000);
  EXPECT_THROW((void)homography_between(radtan(160, 120), to, R), std::logic_error);
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
  auto warper = make_warper(KernelKind::suited);
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
