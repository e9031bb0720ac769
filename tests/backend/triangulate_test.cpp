#include "backend/triangulate.h"

#include <gtest/gtest.h>

#include <random>

#include "backend/simulator.h"

namespace corvid {
namespace {

RayView look(const Camera& camera, const Pose& T, const Eigen::Vector3d& p,
             const Eigen::Vector2d& noise = Eigen::Vector2d::Zero()) {
  const auto pixel = camera.project(T.inverse() * p);
  EXPECT_TRUE(pixel.has_value());
  RayView view;
  view.T_world_camera = T;
  view.pixel = *pixel + noise;
  view.ray_camera = camera.unproject(view.pixel).value();
  return view;
}

Pose at(double x, double y = 0, double z = 0) {
  return {so3_exp({0.02 * x, 0.01, 0.03}), Eigen::Vector3d(x, y, z)};
}

TEST(Triangulate, ExactForEveryCameraModel) {
  for (const Camera& camera : {test::pinhole_camera(), test::radtan_camera(),
                               test::equidistant_camera(), test::fov_camera()}) {
    const Eigen::Vector3d p(0.4, -0.3, 4);
    const std::vector<RayView> views = {look(camera, at(0), p), look(camera, at(0.3), p),
                                        look(camera, at(0.8, 0.2), p)};
    const Triangulation t = triangulate(camera, views, 0.01, 1);
    ASSERT_EQ(t.status, TriangulationStatus::ok);
    EXPECT_LT((t.p_world - p).norm(), 1e-6);
    const double expected = angle_between(p - at(0).translation(), p - at(0.8, 0.2).translation());
    EXPECT_NEAR(t.max_ray_angle_rad, expected, 1e-6);
    EXPECT_LT(t.max_error_px, 1e-4);
  }
}

TEST(Triangulate, MinimisesTheReprojectionError) {
  const Camera camera = test::radtan_camera();
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal(0, 0.5);
  const auto cost = [&](const std::vector<RayView>& views, const Eigen::Vector3d& p) {
    double sum = 0;
    for (const RayView& v : views) {
      const double s = 1 / (v.sigma_px * v.sigma_px);
      sum += s * (*camera.project(v.T_world_camera.inverse() * p) - v.pixel).squaredNorm();
    }
    return sum;
  };
  for (int trial = 0; trial < 50; ++trial) {
    const Eigen::Vector3d p(0.5 * normal(random), 0.5 * normal(random), 5 + normal(random));
    std::vector<RayView> views;
    for (int i = 0; i < 4; ++i) {
      views.push_back(look(camera, at(0.3 * i, 0.1 * i), p, {normal(random), normal(random)}));
      views.back().sigma_px = 0.5 + 0.2 * i;
    }
    const Triangulation t = triangulate(camera, views, 0.01, 10);
    ASSERT_EQ(t.status, TriangulationStatus::ok);
    const double least = cost(views, t.p_world);
    for (int axis = 0; axis < 3; ++axis) {
      for (const double step : {-1e-3, 1e-3}) {
        EXPECT_LE(least, cost(views, t.p_world + step * Eigen::Vector3d::Unit(axis)) + 1e-9);
      }
    }
  }
}

TEST(Triangulate, NearlyParallelRaysAreDegenerate) {
  const Camera camera = test::pinhole_camera();
  const Eigen::Vector3d p(0, 0, 100);
  std::vector<RayView> views = {look(camera, at(0), p), look(camera, at(0.5), p)};
  EXPECT_EQ(triangulate(camera, views, 0.01, 2).status, TriangulationStatus::degenerate);
  EXPECT_EQ(triangulate(camera, views, 0.001, 2).status, TriangulationStatus::ok);
  views[1] = views[0];
  EXPECT_EQ(triangulate(camera, views, 0.0, 2).status, TriangulationStatus::degenerate);
}

TEST(Triangulate, RaysThatDivergeMeetBehindTheCamera) {
  const Camera camera = test::pinhole_camera();
  const Eigen::Vector3d p(0, 0, 5);
  std::vector<RayView> views = {look(camera, at(0), p), look(camera, at(0.5), p)};
  std::swap(views[0].T_world_camera, views[1].T_world_camera);
  EXPECT_EQ(triangulate(camera, views, 0.01, 2).status, TriangulationStatus::behind_camera);
}

TEST(Triangulate, RaysThatMissEachOtherAreALargeError) {
  const Camera camera = test::pinhole_camera();
  const Eigen::Vector3d p(0, 0, 5);
  const std::vector<RayView> views = {look(camera, at(0), p), look(camera, at(1), p),
                                      look(camera, at(0.5), p, {0, 20})};
  const Triangulation t = triangulate(camera, views, 0.01, 2.5);
  EXPECT_EQ(t.status, TriangulationStatus::large_error);
  EXPECT_GT(t.max_error_px, 5);
}

TEST(Triangulate, NeedsTwoViews) {
  const std::vector<RayView> one(1);
  EXPECT_THROW((void)triangulate(test::pinhole_camera(), one, 0.01, 2), std::logic_error);
}

}  // namespace
}  // namespace corvid
