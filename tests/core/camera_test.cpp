#include "corvid/camera.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/lens.h"
#include "oracle/finite_difference.h"

namespace corvid {
namespace {

using test::finite_difference;
using Jacobian23 = Eigen::Matrix<double, 2, 3>;
using JacobianK = Eigen::Matrix<double, 2, Camera::kIntrinsics>;
using Intrinsics = Eigen::Matrix<double, Camera::kIntrinsics, 1>;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

Camera make(CameraModel model, std::array<double, 5> distortion = {}) {
  return {model, 752, 480, 458.654, 457.296, 367.215, 248.375, distortion};
}
Intrinsics intrinsics(const Camera& c) {
  Intrinsics v;
  v << c.fx_px, c.fy_px, c.cx_px, c.cy_px, c.distortion[0], c.distortion[1], c.distortion[2],
      c.distortion[3], c.distortion[4];
  return v;
}
Camera with(const Camera& c, const Intrinsics& v) {
  return {c.model, c.width_px, c.height_px, v[0], v[1], v[2], v[3], {v[4], v[5], v[6], v[7], v[8]}};
}

struct Case {
  const char* name;
  Camera camera;
  double
      max_angle_rad;  ///< of the grid of directions: crosses the edge of validity where it has one
};
std::ostream& operator<<(std::ostream& out, const Case& c) { return out << c.name; }

const Case kCases[] = {
    {"pinhole", make(CameraModel::pinhole), 1.7},
    {"radtan_none", make(CameraModel::radtan), 1.7},
    {"radtan_mild", make(CameraModel::radtan, {-0.2834, 0.0739, 1.9e-4, 1.8e-5, 0}), 1.7},
    {"radtan_pincushion", make(CameraModel::radtan, {0.2, 0.05, -1e-3, 2e-3, 0.01}), 1.7},
    {"radtan_folds", make(CameraModel::radtan, {-0.5, 0.05, 1e-3, -5e-4, -0.01}), 1.7},
    {"radtan_folds_and_returns", make(CameraModel::radtan, {-0.6, 0.2, 0, 0, 0.01}), 1.7},
    {"equidistant_none", make(CameraModel::equidistant), 3.14},
    {"equidistant_mild", make(CameraModel::equidistant, {-0.01, 0.02, -0.015, 0.003, 0}), 3.14},
    {"equidistant_folds", make(CameraModel::equidistant, {-0.1, -0.02, 0.001, 0, 0}), 3.14},
    {"fov_none", make(CameraModel::fov), 1.7},
    {"fov_tiny", make(CameraModel::fov, {3e-5, 0, 0, 0, 0}), 1.5},
    {"fov", make(CameraModel::fov, {0.9, 0, 0, 0, 0}), 3.14},
    {"fov_wide", make(CameraModel::fov, {1.6, 0, 0, 0, 0}), 3.14},
};

/// Directions over a polar grid, with lengths that differ.
template <class F>
void for_directions(double max_angle_rad, const F& f) {
  for (int i = 0; i <= 60; ++i) {
    for (int j = 0; j < 12; ++j) {
      const double theta = max_angle_rad * i / 60, azimuth = 2 * std::numbers::pi * j / 12 + 0.1;
      const Eigen::Vector3d ray(std::sin(theta) * std::cos(azimuth),
                                std::sin(theta) * std::sin(azimuth), std::cos(theta));
      f((0.5 + 0.37 * i) * ray);
      if (i == 0) break;
    }
  }
}

class EveryLens : public testing::TestWithParam<Case> {};

TEST_P(EveryLens, ProjectsWhatItUnprojects) {
  const auto& [name, camera, max_angle] = GetParam();
  int inside = 0;
  for_directions(max_angle, [&](const Eigen::Vector3d& p) {
    const auto pixel = camera.project(p);
    if (!pixel) return;
    // Near a fold the inverse has no slope: there only the pixel, not the ray, can be recovered.
    Jacobian23 J;
    ASSERT_TRUE(camera.project(p, &J));
    const Eigen::JacobiSVD<Jacobian23> svd(J * p.norm() / camera.fx_px);
    const double slope = svd.singularValues()[1];
    const auto ray = camera.unproject(*pixel);
    ASSERT_TRUE(ray || slope < 1e-3) << p.transpose() << " slope " << slope;
    if (!ray) return;
    ++inside;
    EXPECT_NEAR(ray->norm(), 1, 1e-14);
    EXPECT_LT((*ray - p.normalized()).norm(), 1e-11 / std::min(1.0, slope)) << p.transpose();
  });
  EXPECT_GT(inside, 200);
}

TEST_P(EveryLens, UnprojectsEveryPixelOfTheImageThatItCan) {
  const auto& [name, camera, max_angle] = GetParam();
  int found = 0;
  for (int v = -100; v < camera.height_px + 100; v += 9) {
    for (int u = -100; u < camera.width_px + 100; u += 9) {
      const auto ray = camera.unproject({u, v});
      if (!ray) continue;
      ++found;
      ASSERT_TRUE(ray->allFinite());
      const auto pixel = camera.project(*ray);
      ASSERT_TRUE(pixel) << u << " " << v;
      EXPECT_LT((*pixel - Eigen::Vector2d(u, v)).norm(), 1e-7) << u << " " << v;
    }
  }
  EXPECT_GT(found, 2500);
}

TEST_P(EveryLens, PointJacobianMatchesFiniteDifferences) {
  const auto& [name, camera, max_angle] = GetParam();
  int compared = 0;
  for_directions(max_angle, [&](const Eigen::Vector3d& p) {
    Jacobian23 analytic;
    if (!camera.project(p, &analytic)) return;
    const double step = 1e-6 * p.norm();
    bool all = true;
    const auto numeric = finite_difference<2, 3>(
        [&, c = camera](const Eigen::Vector3d& q) -> Eigen::Vector2d {
          const auto pixel = c.project(q);
          all = all && pixel;
          return pixel.value_or(Eigen::Vector2d::Zero());
        },
        p, step);
    if (!all) return;  // the stencil reaches over the edge
    ++compared;
    EXPECT_LT((analytic - numeric).norm(), 1e-6 * (1 + analytic.norm())) << p.transpose();
  });
  EXPECT_GT(compared, 200);
}

TEST_P(EveryLens, IntrinsicsJacobianMatchesFiniteDifferences) {
  const auto& [name, camera, max_angle] = GetParam();
  int compared = 0;
  for_directions(std::min(max_angle, 1.4), [&](const Eigen::Vector3d& p) {
    JacobianK analytic;
    if (!camera.project(p, nullptr, &analytic)) return;
    bool all = true;
    const auto numeric = finite_difference<2, Camera::kIntrinsics>(
        [&, c = camera](const Intrinsics& v) -> Eigen::Vector2d {
          const auto pixel = with(c, v).project(p);
          all = all && pixel;
          return pixel.value_or(Eigen::Vector2d::Zero());
        },
        intrinsics(camera));
    if (!all) return;
    ++compared;
    EXPECT_LT((analytic - numeric).norm(), 1e-6 * (1 + analytic.norm())) << p.transpose();
  });
  EXPECT_GT(compared, 200);
}

TEST_P(EveryLens, PixelJacobianMatchesFiniteDifferences) {
  const auto& [name, camera, max_angle] = GetParam();
  int compared = 0;
  for (double v = 0.25; v < camera.height_px; v += 16) {
    for (double u = 0.25; u < camera.width_px; u += 16) {
      Eigen::Matrix<double, 3, 2> analytic;
      const auto ray = camera.unproject({u, v}, &analytic);
      if (!ray) continue;
      bool all = true;
      const auto numeric = finite_difference<3, 2>(
          [&, c = camera](const Eigen::Vector2d& m) -> Eigen::Vector3d {
            const auto r = c.unproject(m);
            all = all && r;
            return r.value_or(Eigen::Vector3d::Zero());
          },
          Eigen::Vector2d(u, v), 1e-3);
      if (!all || analytic.norm() * camera.fx_px > 5) continue;  // too near a fold to compare
      ++compared;
      EXPECT_LT((analytic - numeric).norm(), 1e-6 * analytic.norm()) << u << " " << v;
    }
  }
  EXPECT_GT(compared, 700);
}

TEST_P(EveryLens, RadiusGrowsWithTheAngleUntilTheModelEnds) {
  const auto& [name, camera, max_angle] = GetParam();
  Camera centred = camera;
  if (camera.model == CameraModel::radtan) centred.distortion[2] = centred.distortion[3] = 0;
  double last = -1;
  bool ended = false;
  for (int i = 0; i <= 4000; ++i) {
    const double theta = max_angle * i / 4000;
    const auto pixel = centred.project({std::sin(theta), 0, std::cos(theta)});
    if (!pixel) {
      ended = true;
      continue;
    }
    EXPECT_FALSE(ended) << "valid again beyond the edge at " << theta;
    EXPECT_GT(pixel->x() - camera.cx_px, last) << theta;
    last = pixel->x() - camera.cx_px;
  }
}

TEST_P(EveryLens, NeverSaysNan) {
  const auto& [name, camera, max_angle] = GetParam();
  const double values[] = {0.0, -0.0,  1.0,    -1.0,  1e-320, -1e-200, 1e-160, 1e-8,
                           1e8, 1e160, -1e200, 1e308, kInf,   -kInf,   kNan};
  for (const double x : values) {
    for (const double y : values) {
      for (const double z : values) {
        Jacobian23 by_point;
        JacobianK by_intrinsics;
        const auto pixel = camera.project({x, y, z}, &by_point, &by_intrinsics);
        if (!pixel) continue;
        EXPECT_TRUE(pixel->allFinite()) << x << " " << y << " " << z;
        EXPECT_FALSE(by_point.hasNaN()) << x << " " << y << " " << z;
        EXPECT_FALSE(by_intrinsics.hasNaN()) << x << " " << y << " " << z;
      }
      Eigen::Matrix<double, 3, 2> by_pixel;
      const auto ray = camera.unproject({x, y}, &by_pixel);
      if (!ray) continue;
      EXPECT_TRUE(ray->allFinite() && by_pixel.allFinite()) << x << " " << y;
    }
  }
}

TEST_P(EveryLens, UndistortedCameraLooksInside) {
  const auto& [name, camera, max_angle] = GetParam();
  const Camera flat = camera.undistorted();
  EXPECT_EQ(flat.model, CameraModel::pinhole);
  EXPECT_EQ(flat.width_px, camera.width_px);
  EXPECT_EQ(flat.height_px, camera.height_px);
  EXPECT_EQ(flat.validate(), "");
  double widest_rad = 0;
  // How many border pixels of a pinhole show something that the original does not.
  const auto strays = [&, &original = camera](const Camera& c) {
    int n = 0;
    for (int v = 0; v < c.height_px; ++v) {
      const bool edge_row = v == 0 || v == c.height_px - 1;
      for (int u = 0; u < c.width_px; u += edge_row ? 1 : c.width_px - 1) {
        const auto ray = c.unproject({u, v});
        if (!ray) return -1;
        widest_rad = std::max(widest_rad, std::acos(ray->z()));
        const auto pixel = original.project(*ray);
        n += !pixel || !original.in_image(*pixel, -1e-9);
      }
    }
    return n;
  };
  EXPECT_EQ(strays(flat), 0);
  // As wide as it can be: one per cent wider is too wide, unless the view is at its limit.
  Camera wider = flat;
  wider.fx_px *= 0.99;
  wider.fy_px *= 0.99;
  wider.cx_px += 0.01 * ((flat.width_px - 1) / 2.0 - flat.cx_px);
  wider.cy_px += 0.01 * ((flat.height_px - 1) / 2.0 - flat.cy_px);
  EXPECT_TRUE(widest_rad > 1.2 || strays(wider) > 0) << widest_rad << " rad";
}

INSTANTIATE_TEST_SUITE_P(Camera, EveryLens, testing::ValuesIn(kCases),
                         [](const auto& test) { return std::string(test.param.name); });

TEST(Camera, KnownPixels) {
  // Typed by hand from the equations in docs/conventions.md.
  Camera c = make(CameraModel::pinhole);
  EXPECT_TRUE(
      c.project({0.5, -0.25, 1})
          ->isApprox(Eigen::Vector2d(458.654 * 0.5 + 367.215, -457.296 * 0.25 + 248.375), 1e-14));
  c = make(CameraModel::radtan, {0.1, 0.02, 0.003, 0.004, 0.005});
  // x = 0.5, y = 1, r^2 = 1.25
  const double radial = 1 + 0.1 * 1.25 + 0.02 * 1.5625 + 0.005 * 1.953125;
  const double xd = 0.5 * radial + 2 * 0.003 * 0.5 + 0.004 * (1.25 + 0.5);
  const double yd = 1.0 * radial + 0.003 * (1.25 + 2) + 2 * 0.004 * 0.5;
  EXPECT_TRUE(c.project({1, 2, 2})->isApprox(
      Eigen::Vector2d(458.654 * xd + 367.215, 457.296 * yd + 248.375), 1e-14));
  c = make(CameraModel::equidistant, {0.1, 0, 0, 0.01, 0});
  const double theta = std::numbers::pi / 4;
  const double radius = theta * (1 + 0.1 * std::pow(theta, 2) + 0.01 * std::pow(theta, 8));
  EXPECT_NEAR(c.project({0, 3, 3})->y(), 457.296 * radius + 248.375, 1e-10);
  EXPECT_NEAR(c.project({0, 3, 3})->x(), 367.215, 1e-10);
  EXPECT_NEAR(make(CameraModel::equidistant).project({1, 0, -1})->x(),
              458.654 * 0.75 * std::numbers::pi + 367.215, 1e-10);
  c = make(CameraModel::fov, {0.9, 0, 0, 0, 0});
  EXPECT_NEAR(c.project({1, 0, 2})->x(),
              458.654 * std::atan(2 * 0.5 * std::tan(0.45)) / 0.9 + 367.215, 1e-10);
}

TEST(Camera, NothingBehindAPinhole) {
  for (const CameraModel model : {CameraModel::pinhole, CameraModel::radtan, CameraModel::fov}) {
    EXPECT_FALSE(make(model).project({0.1, 0.1, 0}));
    EXPECT_FALSE(make(model).project({0.1, 0.1, -1}));
  }
}

TEST(Camera, FoldedPointsDoNotProject) {
  // r (1 - 0.5 r^2) rises until r = sqrt(2/3) and falls beyond.
  const Camera c = make(CameraModel::radtan, {-0.5, 0, 0, 0, 0});
  const double edge = std::sqrt(2.0 / 3.0);
  EXPECT_TRUE(c.project({edge - 1e-4, 0, 1}));
  EXPECT_FALSE(c.project({edge + 1e-4, 0, 1}));
  EXPECT_FALSE(c.project({0, 100, 1}));
  // No ray meets a pixel beyond the largest radius, 2/3 sqrt(2/3).
  const double max_px = c.fx_px * edge * 2 / 3;
  EXPECT_TRUE(c.unproject({c.cx_px + max_px - 0.01, c.cy_px}));
  EXPECT_FALSE(c.unproject({c.cx_px + max_px + 0.01, c.cy_px}));
  EXPECT_FALSE(c.unproject({c.cx_px + 1e6, c.cy_px + 1e6}));
}

TEST(Camera, BeyondTheFisheyesReachNothing) {
  const Camera plain = make(CameraModel::equidistant);
  EXPECT_TRUE(plain.unproject({plain.cx_px + plain.fx_px * 3.1, plain.cy_px}));
  EXPECT_FALSE(plain.unproject({plain.cx_px + plain.fx_px * 3.2, plain.cy_px}));
  EXPECT_FALSE(plain.project({0, 0, -1}));
  const Camera fov = make(CameraModel::fov, {0.9, 0, 0, 0, 0});
  EXPECT_TRUE(fov.unproject({fov.cx_px + fov.fx_px * 3.4, fov.cy_px}));
  EXPECT_FALSE(fov.unproject({fov.cx_px + fov.fx_px * 3.5, fov.cy_px}));
}

TEST(Camera, UndistortedKeepsALinearCamera) {
  EXPECT_EQ(make(CameraModel::pinhole).undistorted(), make(CameraModel::pinhole));
  EXPECT_EQ(make(CameraModel::radtan).undistorted(), make(CameraModel::pinhole));
  EXPECT_EQ(make(CameraModel::fov).undistorted(), make(CameraModel::pinhole));
}

TEST(Camera, UndistortedWithThePrincipalPointOutside) {
  Camera c = make(CameraModel::radtan, {-0.1, 0.01, 0, 0, 0});
  c.cx_px = -50;  // an image cut out of a larger one
  const Camera flat = c.undistorted();
  for (int v = 0; v < flat.height_px; ++v) {
    for (const int u : {0, flat.width_px - 1}) {
      const auto pixel = c.project(*flat.unproject({u, v}));
      ASSERT_TRUE(pixel && c.in_image(*pixel, -1e-9)) << u << " " << v;
    }
  }
}

TEST(Camera, ValidateListsEveryProblem) {
  EXPECT_EQ(make(CameraModel::pinhole).validate(), "");
  Camera c = make(CameraModel::fov, {4, 0, 0, 0, kNan});
  c.width_px = 0;
  c.fx_px = -1;
  c.fy_px = kNan;
  c.cx_px = kInf;
  const std::string text = c.validate();
  for (const char* part :
       {"0 x 480", "fx must be", "fy must be", "cx must be", "distortion[4]", "omega must be in"}) {
    EXPECT_NE(text.find(part), std::string::npos) << part << " in: " << text;
  }
  EXPECT_EQ(text.find("cy must"), std::string::npos);
}

TEST(Camera, InImageCountsPixelCentres) {
  const Camera c = make(CameraModel::pinhole);
  EXPECT_TRUE(c.in_image({0, 0}));
  EXPECT_TRUE(c.in_image({751, 479}));
  EXPECT_FALSE(c.in_image({751.01, 479}));
  EXPECT_FALSE(c.in_image({-0.01, 0}));
  EXPECT_FALSE(c.in_image({4.9, 100}, 5));
  EXPECT_TRUE(c.in_image({5, 100}, 5));
  EXPECT_FALSE(c.in_image({kNan, 100}));
}

TEST(Camera, KIsTheLinearPart) {
  const Camera c = make(CameraModel::pinhole);
  const Eigen::Vector3d p(0.3, -0.2, 2);
  EXPECT_TRUE((c.K() * p).hnormalized().isApprox(*c.project(p), 1e-14));
}

TEST(Camera, ModelsHaveNames) {
  EXPECT_EQ(to_string(CameraModel::pinhole), "pinhole");
  EXPECT_EQ(to_string(CameraModel::radtan), "radtan");
  EXPECT_EQ(to_string(CameraModel::equidistant), "equidistant");
  EXPECT_EQ(to_string(CameraModel::fov), "fov");
}

TEST(Lens, PositiveUpToFindsASignChangeAnywhere) {
  using lens::positive_up_to;
  // (x - a)(x - b) / (a b): negative between a and b only.
  const auto dip = [](double a, double b) {
    return std::array<double, 4>{1, -(a + b) / (a * b), 1 / (a * b), 0};
  };
  EXPECT_TRUE(positive_up_to(dip(1, 2), 0.999));
  EXPECT_FALSE(positive_up_to(dip(1, 2), 1.5));
  EXPECT_FALSE(positive_up_to(dip(1, 2), 100));
  EXPECT_FALSE(positive_up_to(dip(1, 1.02), 100));
  EXPECT_TRUE(positive_up_to(dip(-2, -1), 100));
  // ((x - 1)^2 + m) / (1 + m) never is.
  const double m = 1e-3;
  EXPECT_TRUE(positive_up_to(std::array{1.0, -2 / (1 + m), 1 / (1 + m), 0.0}, 50));
  EXPECT_TRUE(positive_up_to(std::array{1.0, -2 / (1 + m), 1 / (1 + m), 0.0, 0.0}, 50));
  EXPECT_FALSE(positive_up_to(std::array{1.0, -2 / (1 - m), 1 / (1 - m), 0.0, 0.0}, 2));
  EXPECT_FALSE(positive_up_to(std::array{1.0, 0.0, 0.0, 0.0, -1e-4}, 11));
  EXPECT_TRUE(positive_up_to(std::array{1.0, 0.0, 0.0, 0.0, -1e-4}, 9));
  EXPECT_FALSE(positive_up_to(std::array{1.0, kNan, 0.0, 0.0}, 1));
}

}  // namespace
}  // namespace corvid
