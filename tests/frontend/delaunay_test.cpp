#include "frontend/disambiguate/delaunay.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <set>

namespace corvid {
namespace {

using Points = std::vector<Eigen::Vector2d>;

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c) {
  return (b - a).x() * (c - a).y() - (b - a).y() * (c - a).x();
}

bool holds(const Points& p, const Delaunay::Triangle& t, const Eigen::Vector2d& x, double slack) {
  const double s = cross(p[t[0]], p[t[1]], p[t[2]]) > 0 ? 1 : -1;
  for (std::size_t k = 0; k < 3; ++k)
    if (s * cross(p[t[k]], p[t[(k + 1) % 3]], x) < -slack) return false;
  return true;
}

Points random_points(std::size_t count, std::uint64_t seed, double size = 700) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> u(0, size);
  Points points;
  for (std::size_t i = 0; i < count; ++i) points.emplace_back(u(random), u(random));
  return points;
}

TEST(Delaunay, TrianglesHoldThePlaceAndTheirCirclesNoPoint) {
  const Points points = random_points(300, 1);
  Delaunay delaunay(points);
  const Points places = random_points(500, 2, 900);
  const auto triangles = delaunay.triangles(places);
  int found = 0;
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (!triangles[i]) continue;
    ++found;
    const auto& t = *triangles[i];
    EXPECT_TRUE(holds(points, t, places[i], 1.0));
    // Circumcentre, from the two bisectors.
    Eigen::Matrix2d A;
    A << (points[t[1]] - points[t[0]]).transpose(), (points[t[2]] - points[t[0]]).transpose();
    const Eigen::Vector2d b((points[t[1]].squaredNorm() - points[t[0]].squaredNorm()) / 2,
                            (points[t[2]].squaredNorm() - points[t[0]].squaredNorm()) / 2);
    const Eigen::Vector2d centre = A.inverse() * b;
    const double radius = (points[t[0]] - centre).norm();
    for (const Eigen::Vector2d& p : points) EXPECT_GT((p - centre).norm(), radius * 0.999 - 0.01);
  }
  EXPECT_GT(found, 270) << "500 places on 900 x 900, the points on 700 x 700";
  EXPECT_LT(found, 320);
}

TEST(Delaunay, NeighboursAreMutualAndSixOnAverage) {
  const Points points = random_points(1000, 3);
  const Delaunay delaunay(points);
  std::size_t all = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto near = delaunay.neighbours(i);
    all += near.size();
    double nearest = std::numeric_limits<double>::infinity();
    std::size_t nearest_index = 0;
    for (std::size_t k = 0; k < points.size(); ++k)
      if (k != i && (points[k] - points[i]).norm() < nearest) {
        nearest = (points[k] - points[i]).norm();
        nearest_index = k;
      }
    EXPECT_TRUE(std::find(near.begin(), near.end(), nearest_index) != near.end());
    for (std::size_t k : near) {
      const auto back = delaunay.neighbours(k);
      EXPECT_TRUE(std::find(back.begin(), back.end(), i) != back.end());
    }
  }
  EXPECT_NEAR(static_cast<double>(all) / 1000, 6, 0.1);
}

TEST(Delaunay, AnyPositionIsDefined) {
  const double nan = std::nan(""), infinity = std::numeric_limits<double>::infinity();
  Points grid, line, same(50, Eigen::Vector2d(3, 4)), nearly, huge, bad;
  for (int y = 0; y < 20; ++y)
    for (int x = 0; x < 20; ++x) grid.emplace_back(10 * x, 10 * y);
  for (int i = 0; i < 100; ++i) {
    line.emplace_back(i % 37, 2 * (i % 37));
    nearly.emplace_back(5 + 1e-12 * i, 5 - 1e-13 * i * i);
    huge.emplace_back(1e300 * i, -1e300 * (i % 7));
  }
  bad = {{nan, 1}, {1, infinity}, {2, 3}, {5, 7}, {9, 1}, {-infinity, nan}};
  for (const Points& points :
       {Points{}, Points{{1, 2}}, Points{{1, 2}, {3, 4}}, grid, line, same, nearly, huge, bad}) {
    Delaunay delaunay(points);
    for (std::size_t i = 0; i < points.size(); ++i)
      for (std::size_t k : delaunay.neighbours(i)) ASSERT_LT(k, points.size());
    const auto triangles = delaunay.triangles(points);
    EXPECT_EQ(triangles.size(), points.size());
    for (const auto& t : triangles) EXPECT_FALSE(t) << "at a vertex";
    EXPECT_FALSE(delaunay.triangles(Points{{nan, 0}})[0]);
    EXPECT_FALSE(delaunay.triangles(Points{{1e308, 1e308}})[0]);
  }
  EXPECT_EQ(Delaunay(bad).neighbours(0).size(), 0U);
  EXPECT_EQ(Delaunay(bad).neighbours(2).size(), 2U);
  // Copies of a point share its neighbours.
  const Points twice{{0, 0}, {10, 0}, {0, 10}, {10, 0}};
  const Delaunay delaunay(twice);
  EXPECT_EQ(std::set<std::size_t>(delaunay.neighbours(3).begin(), delaunay.neighbours(3).end()),
            (std::set<std::size_t>{0, 2}));
  EXPECT_EQ(std::set<std::size_t>(delaunay.neighbours(0).begin(), delaunay.neighbours(0).end()),
            (std::set<std::size_t>{1, 2}));
  // In the cells of a grid, and on their borders.
  Delaunay cells(grid);
  Points places;
  for (int i = 0; i < 100; ++i) places.emplace_back(5.05 + 1.7 * i, 90);
  for (const auto& t : cells.triangles(places)) EXPECT_TRUE(t);
}

}  // namespace
}  // namespace corvid
