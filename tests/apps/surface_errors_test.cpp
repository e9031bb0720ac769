#include "apps/surface_errors.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "apps/triangle_tree.h"

namespace corvid {
namespace {

Eigen::Vector3d random_point(std::mt19937& rng, double size) {
  std::uniform_real_distribution<double> uniform(-size, size);
  const double x = uniform(rng), y = uniform(rng), z = uniform(rng);
  return {x, y, z};
}

/// The rectangle [x0, x1] x [y0, y1] at height z, in n x n cells.
TriangleMesh plane(float x0, float x1, float y0, float y1, float z, unsigned n = 8) {
  TriangleMesh mesh;
  for (unsigned j = 0; j <= n; ++j) {
    for (unsigned i = 0; i <= n; ++i) {
      const float u = static_cast<float>(i) / static_cast<float>(n);
      const float v = static_cast<float>(j) / static_cast<float>(n);
      mesh.vertices.emplace_back(x0 + u * (x1 - x0), y0 + v * (y1 - y0), z);
    }
  }
  for (unsigned j = 0; j < n; ++j) {
    for (unsigned i = 0; i < n; ++i) {
      const unsigned a = j * (n + 1) + i, b = a + 1, c = a + n + 1, d = c + 1;
      mesh.triangles.push_back({a, b, d});
      mesh.triangles.push_back({a, d, c});
    }
  }
  return mesh;
}
TriangleMesh operator+(TriangleMesh a, const TriangleMesh& b) {
  const auto offset = static_cast<std::uint32_t>(a.vertices.size());
  a.vertices.insert(a.vertices.end(), b.vertices.begin(), b.vertices.end());
  for (const auto& t : b.triangles) {
    a.triangles.push_back({t[0] + offset, t[1] + offset, t[2] + offset});
  }
  return a;
}
SurfaceOptions few_samples() {
  SurfaceOptions options;
  options.estimate_samples = 5000;
  options.truth_samples = 20000;
  return options;
}

TEST(TriangleTree, AgreesWithTryingAll) {
  std::mt19937 rng(11);
  for (const unsigned n : {1U, 2U, 4U, 5U, 9U, 300U}) {
    TriangleMesh mesh;
    for (unsigned i = 0; i < n; ++i) {
      const Eigen::Vector3d at = random_point(rng, i % 2 ? 1 : 10);
      const double size = i % 7 == 0 ? 8 : 0.5;  // large among small
      for (int k = 0; k < 3; ++k) {
        mesh.vertices.push_back((at + random_point(rng, size)).cast<float>());
      }
      mesh.triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    const TriangleTree tree(mesh);
    for (int k = 0; k < 200; ++k) {
      const Eigen::Vector3d p = random_point(rng, 12);
      double best = std::numeric_limits<double>::infinity();
      for (unsigned i = 0; i < n; ++i) {
        best = std::min(best, (nearest_in_triangle(p, *triangle_corners(mesh, i)) - p).norm());
      }
      EXPECT_DOUBLE_EQ(tree.distance(p), best);
    }
  }
  EXPECT_TRUE(TriangleTree({}).empty());
  EXPECT_THROW((void)TriangleTree({}).distance({0, 0, 0}), std::logic_error);
}

TEST(NearestInTriangle, AgreesWithADenseSearch) {
  std::mt19937 rng(12);
  for (int k = 0; k < 100; ++k) {
    const Eigen::Vector3d a = random_point(rng, 1), b = random_point(rng, 1),
                          c = random_point(rng, 1), p = random_point(rng, 2);
    const double found = (nearest_in_triangle(p, {a, b, c}) - p).norm();
    double best = std::numeric_limits<double>::infinity();
    constexpr int kSteps = 200;
    for (int i = 0; i <= kSteps; ++i) {
      for (int j = 0; i + j <= kSteps; ++j) {
        const double s = static_cast<double>(i) / kSteps, t = static_cast<double>(j) / kSteps;
        best = std::min(best, (a + s * (b - a) + t * (c - a) - p).norm());
      }
    }
    EXPECT_LE(found, best + 1e-12);
    EXPECT_NEAR(found, best, 0.02);
  }
}

TEST(NearestInTriangle, DegenerateTrianglesAreSegmentsAndPoints) {
  const Eigen::Vector3d a(0, 0, 0), b(2, 0, 0);
  EXPECT_EQ(nearest_in_triangle({1, 1, 0}, {a, b, a}), Eigen::Vector3d(1, 0, 0));
  EXPECT_EQ(nearest_in_triangle({1, 1, 0}, {a, a, a}), a);
}

TEST(SampleSurface, SpreadsByArea) {
  const TriangleMesh mesh = plane(0, 1, 0, 1, 0, 1) + plane(10, 13, 0, 1, 0, 5);
  const SurfaceSamples s = sample_surface(mesh, 4000);
  EXPECT_NEAR(s.area, 4, 1e-5);
  ASSERT_EQ(s.points.size(), 4000u);
  int small = 0, left = 0;
  for (const auto& p : s.points) {
    small += p.x() < 5;
    left += p.x() < 0.5;
    EXPECT_NEAR(p.z(), 0, 1e-12);
  }
  EXPECT_NEAR(small, 1000, 5);
  EXPECT_NEAR(left, 500, 25);
  EXPECT_EQ(sample_surface(mesh, 4000).points, s.points);
}

TEST(CompareSurfaces, PlaneAtAKnownDistance) {
  const SurfaceErrors e =
      compare_surfaces(plane(0, 1, 0, 1, 0.05F), plane(-1, 2, -1, 2, 0), Sim3(), few_samples());
  EXPECT_EQ(e.problem, "");
  EXPECT_EQ(e.estimate_samples, 5000u);
  EXPECT_EQ(e.truth_samples, 20000u);
  EXPECT_NEAR(e.median_m, 0.05, 1e-6);
  EXPECT_NEAR(e.mean_m, 0.05, 1e-6);
  EXPECT_NEAR(e.rmse_m, 0.05, 1e-6);
  EXPECT_NEAR(e.accuracy90_m, 0.05, 1e-6);
  EXPECT_NEAR(e.estimate_area_m2, 1, 1e-5);
  EXPECT_NEAR(e.truth_area_m2, 9, 1e-4);
}

TEST(CompareSurfaces, PartOfTheSurfaceIsFar) {
  const TriangleMesh estimate = plane(0, 0.8F, 0, 1, 0.01F) + plane(0.8F, 1, 0, 1, 0.3F);
  const SurfaceErrors e = compare_surfaces(estimate, plane(-1, 2, -1, 2, 0), Sim3(), few_samples());
  EXPECT_NEAR(e.median_m, 0.01, 1e-6);
  EXPECT_NEAR(e.accuracy90_m, 0.3, 1e-6);
  EXPECT_NEAR(e.mean_m, 0.8 * 0.01 + 0.2 * 0.3, 1e-3);
}

TEST(CompareSurfaces, CompletenessIsTheCoveredShareOfTheTruth) {
  SurfaceOptions options = few_samples();
  options.completeness_distances_m = {0.01, 0.03, 0.5};
  const SurfaceErrors e =
      compare_surfaces(plane(0, 1, 0, 1, 0.02F), plane(0, 4, 0, 1, 0), Sim3(), options);
  ASSERT_EQ(e.completeness.size(), 3u);
  EXPECT_EQ(e.completeness[0], 0);
  EXPECT_NEAR(e.completeness[1], (1 + std::sqrt(0.03 * 0.03 - 0.02 * 0.02)) / 4, 2e-3);
  EXPECT_NEAR(e.completeness[2], (1 + std::sqrt(0.25 - 0.0004)) / 4, 2e-3);

  options.seen = [](const Eigen::Vector3d& p) { return p.x() < 2; };
  const SurfaceErrors half =
      compare_surfaces(plane(0, 1, 0, 1, 0.02F), plane(0, 4, 0, 1, 0), Sim3(), options);
  EXPECT_NEAR(static_cast<double>(half.truth_samples), 10000, 50);
  EXPECT_NEAR(half.completeness[1], 2 * e.completeness[1], 4e-3);
  options.seen = [](const Eigen::Vector3d&) { return false; };
  const SurfaceErrors blind =
      compare_surfaces(plane(0, 1, 0, 1, 0), plane(0, 1, 0, 1, 0), Sim3(), options);
  EXPECT_EQ(blind.truth_samples, 0u);
  EXPECT_EQ(blind.completeness[2], 0);
}

TEST(CompareSurfaces, UndoesThePlantedSimilarity) {
  const Sim3 T(3, so3_exp({0.5, -0.2, 1}), {10, -5, 2});
  TriangleMesh estimate = plane(0, 1, 0, 1, 0.1F);
  for (auto& v : estimate.vertices) v = (T.inverse() * v.cast<double>()).cast<float>();
  const TriangleMesh truth = plane(-1, 2, -1, 2, 0);
  const SurfaceErrors e = compare_surfaces(estimate, truth, T, few_samples());
  EXPECT_NEAR(e.median_m, 0.1, 1e-5);
  EXPECT_NEAR(e.accuracy90_m, 0.1, 1e-5);
  EXPECT_GT(compare_surfaces(estimate, truth, Sim3(), few_samples()).median_m, 1);
}

TEST(CompareSurfaces, LargeTrianglesCostNoPrecision) {
  const SurfaceErrors e = compare_surfaces(
      plane(0, 1, 0, 1, 0.05F), plane(-500, 500, -500, 500, 0, 1), Sim3(), few_samples());
  EXPECT_NEAR(e.accuracy90_m, 0.05, 1e-6);
}

TEST(CompareSurfaces, BrokenMeshesAreRefusedOrPassedOver) {
  const TriangleMesh good = plane(0, 1, 0, 1, 0);
  EXPECT_THAT(compare_surfaces({}, good, Sim3()).problem, testing::HasSubstr("estimated mesh"));
  EXPECT_THAT(compare_surfaces(good, {}, Sim3(), few_samples()).problem,
              testing::HasSubstr("true mesh"));
  TriangleMesh flat;
  flat.vertices.resize(3, Eigen::Vector3f(1, 2, 3));
  flat.triangles.push_back({0, 1, 2});
  EXPECT_NE(compare_surfaces(flat, good, Sim3(), few_samples()).problem, "");

  TriangleMesh mixed = good;
  mixed.vertices.emplace_back(std::numeric_limits<float>::quiet_NaN(), 0.0F, 0.0F);
  mixed.triangles.push_back({0, 1, static_cast<std::uint32_t>(mixed.vertices.size() - 1)});
  mixed.triangles.push_back({0, 1, 4000000000U});
  mixed.triangles.insert(mixed.triangles.begin(), {0, 0, 0});
  const SurfaceErrors e = compare_surfaces(mixed, good, Sim3(), few_samples());
  EXPECT_EQ(e.problem, "");
  EXPECT_LT(e.rmse_m, 1e-7);
  EXPECT_NEAR(e.estimate_area_m2, 1, 1e-5);
}

}  // namespace
}  // namespace corvid
