#include "frontend/epipolar_strip.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "frontend/epipolar.h"

namespace corvid {
namespace {

Camera camera(CameraModel model = CameraModel::pinhole) {
  Camera c;
  c.model = model;
  c.width_px = 640;
  c.height_px = 480;
  c.fx_px = c.fy_px = 450;
  c.cx_px = 319.5;
  c.cy_px = 239.5;
  if (model == CameraModel::radtan) c.distortion = {-0.28, 0.07, 0, 0, 0};
  return c;
}

bool covered(const std::vector<SearchWindow>& windows, const Eigen::Vector2d& x) {
  return std::any_of(windows.begin(), windows.end(), [&](const SearchWindow& w) {
    return std::abs(x.x() - w.centre.x()) <= w.radius_x_px + 1e-9 &&
           std::abs(x.y() - w.centre.y()) <= w.radius_y_px + 1e-9;
  });
}

TEST(EpipolarStrip, ALineIsClippedToTheImage) {
  const auto ends = clip_line({0, 1, -100}, camera(), 0);  // y = 100
  ASSERT_TRUE(ends);
  EXPECT_NEAR(ends->first.y(), 100, 1e-9);
  EXPECT_NEAR(std::abs(ends->second.x() - ends->first.x()), 639, 1e-9);
  EXPECT_FALSE(clip_line({0, 1, 100}, camera(), 50));  // y = -100
  EXPECT_TRUE(clip_line({0, 1, 100}, camera(), 150));
  EXPECT_FALSE(clip_line({0, 0, 1}, camera(), 0));
  EXPECT_FALSE(clip_line({std::numeric_limits<double>::quiet_NaN(), 1, 0}, camera(), 0));
}

TEST(EpipolarStrip, NothingThatADistortedLensSeesIsClipped) {
  const Camera lens = camera(CameraModel::radtan);
  for (const Eigen::Vector2d& pixel :
       {Eigen::Vector2d(2, 3), Eigen::Vector2d(636, 4), Eigen::Vector2d(3, 470)}) {
    const auto x = undistort_pixel(lens, pixel);
    ASSERT_TRUE(x);
    for (double angle : {0.1, 0.8, 1.6, 2.4}) {
      const Eigen::Vector2d normal(std::cos(angle), std::sin(angle));
      const auto ends = clip_line({normal.x(), normal.y(), -normal.dot(*x)}, lens, 4);
      ASSERT_TRUE(ends);
      const Eigen::Vector2d along = (ends->second - ends->first).normalized();
      EXPECT_GE(along.dot(*x - ends->first), 0);
      EXPECT_LE(along.dot(*x - ends->second), 0);
    }
  }
}

TEST(EpipolarStrip, CoversTheLineAndItsSides) {
  for (double angle = 0; angle < 3.1; angle += 0.2) {
    const Eigen::Vector2d normal(std::cos(angle), std::sin(angle)), along(-normal.y(), normal.x());
    const Eigen::Vector2d middle(300, 200);
    const Eigen::Vector3d line(normal.x(), normal.y(), -normal.dot(middle));
    const auto ends = clip_line(line, camera(), 0);
    ASSERT_TRUE(ends);
    const auto windows = strip_windows(camera(), ends->first, ends->second, 4, 24);
    double area = 0;
    for (const SearchWindow& w : windows) area += 4 * w.radius_x_px * w.radius_y_px;
    const double length = (ends->second - ends->first).norm();
    for (double t = 0; t <= 1; t += 0.01)
      for (double side : {-2.8, 0.0, 2.8})
        EXPECT_TRUE(
            covered(windows, ends->first + t * (ends->second - ends->first) + side * normal));
    EXPECT_LT(area, 3.3 * length * 8);  // not the whole box of a slanted line
  }
}

TEST(EpipolarStrip, FollowsTheLinesOfADistortedLens) {
  const Camera lens = camera(CameraModel::radtan);
  const Eigen::Vector2d from(-60, 20), to(700, 60);  // bent near the upper border
  const auto windows = strip_windows(lens, from, to, 3, 24);
  for (double t = 0.05; t < 0.95; t += 0.01) {
    const Eigen::Vector2d x = from + t * (to - from);
    const auto pixel = lens.project(
        Eigen::Vector3d((x.x() - lens.cx_px) / lens.fx_px, (x.y() - lens.cy_px) / lens.fy_px, 1));
    ASSERT_TRUE(pixel);
    if (lens.in_image(*pixel)) {
      EXPECT_TRUE(covered(windows, *pixel));
    }
  }
}

TEST(EpipolarStrip, ASegmentOfNoLengthIsOneWindow) {
  const auto windows = strip_windows(camera(), {100, 100}, {100, 100}, 3, 24);
  ASSERT_EQ(windows.size(), 1U);
  EXPECT_TRUE(covered(windows, {102, 98}));
  EXPECT_TRUE(strip_windows(camera(), {-5000, 100}, {-5000, 100}, 3, 24).empty());
}

}  // namespace
}  // namespace corvid
