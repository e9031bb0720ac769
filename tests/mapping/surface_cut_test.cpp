#include "mapping/surface_cut.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <vector>

#include "mapping/mesh_checks.h"
#include "replay/synthetic_flight.h"
#include "scenes/plane_views.h"

namespace corvid {
namespace {

using testing::PlaneScene;
using testing::topology;

/// Depth maps with the colours that the views saw.
struct Views {
  std::vector<DepthMap> maps;
  std::vector<ColourImage> colours;
  [[nodiscard]] std::vector<SurfaceCutView> list() const {
    std::vector<SurfaceCutView> out;
    for (std::size_t i = 0; i < maps.size(); ++i) {
      out.push_back({&maps[i], colours.empty() ? nullptr : &colours[i]});
    }
    return out;
  }
};

DepthMap depth_map(const Camera& camera, const Pose& T_world_camera, FloatImage depth) {
  DepthMap map;
  map.camera = camera;
  map.T_world_camera = T_world_camera;
  map.confidence = FloatImage(depth.width(), depth.height());
  for (std::size_t i = 0; i < depth.size(); ++i) {
    map.confidence.data()[i] = depth.data()[i] > 0 ? 0.9F : 0.F;
  }
  map.depth = std::move(depth);
  return map;
}

Pose looking_at(const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
  const Eigen::Vector3d z = (to - from).normalized();
  const Eigen::Vector3d side =
      std::abs(z.y()) < 0.9 ? Eigen::Vector3d(0, 1, 0) : Eigen::Vector3d(1, 0, 0);
  Eigen::Matrix3d R;
  R.col(2) = z;
  R.col(0) = side.cross(z).normalized();
  R.col(1) = z.cross(R.col(0));
  return {Eigen::Quaterniond(R), from};
}

/// Cameras around the origin, evenly spread over a sphere.
std::vector<Pose> all_around(int n, double distance) {
  std::vector<Pose> out;
  for (int i = 0; i < n; ++i) {
    const double z = 1 - (2 * i + 1.0) / n, r = std::sqrt(1 - z * z), a = 2.399963 * i;
    out.push_back(looking_at(distance * Eigen::Vector3d(r * std::cos(a), r * std::sin(a), z),
                             Eigen::Vector3d::Zero()));
  }
  return out;
}

/// A ball of radius 1 at the origin before a black background, red above (z > 0), blue below.
Views ball_views(int n = 24, double noise = 0) {
  PlaneScene scene;
  scene.spheres = {{Eigen::Vector3d::Zero(), 1}};
  const Camera camera = testing::pinhole(100, 100, 120);
  Views out;
  std::mt19937 random(4);
  std::normal_distribution<double> error(0, noise > 0 ? noise : 1);
  for (const Pose& T : all_around(n, 3.2)) {
    FloatImage depth = scene.depth(camera, T);
    ColourImage colour(100, 100);
    for (int y = 0; y < 100; ++y) {
      for (int x = 0; x < 100; ++x) {
        if (!(depth(x, y) > 0)) continue;
        const Eigen::Vector3d ray((x - camera.cx_px) / camera.fx_px,
                                  (y - camera.cy_px) / camera.fy_px, 1);
        const Eigen::Vector3d p = T * (ray * depth(x, y));
        colour(x, y) = p.z() > 0 ? Rgb8{250, 0, 0} : Rgb8{0, 0, 250};
        if (noise > 0) depth(x, y) += static_cast<float>(error(random));
      }
    }
    out.maps.push_back(depth_map(camera, T, std::move(depth)));
    out.colours.push_back(std::move(colour));
  }
  return out;
}

SurfaceCutOptions ball_options(double voxel_size = 0.05) {
  SurfaceCutOptions options;
  options.box =
      Eigen::AlignedBox3d(Eigen::Vector3d::Constant(-1.5), Eigen::Vector3d::Constant(1.5));
  options.voxel_size = voxel_size;
  return options;
}

SurfaceCut cut_of(const Views& views, const SurfaceCutOptions& options) {
  auto cut = cut_surface(views.list(), options);
  if (!cut) throw std::runtime_error(cut.error().to_string());
  return std::move(*cut);
}

Views moved(Views views, const Eigen::Vector3d& by) {
  for (DepthMap& map : views.maps) {
    map.T_world_camera = Pose(map.T_world_camera.rotation(), map.T_world_camera.translation() + by);
  }
  return views;
}

template <class Distance>
std::vector<double> sorted_errors(const TriangleMesh& mesh, Distance&& distance) {
  std::vector<double> out;
  for (const auto& v : mesh.vertices) out.push_back(std::abs(distance(v.cast<double>())));
  std::sort(out.begin(), out.end());
  return out;
}

TEST(SurfaceCut, ABallIsClosedManifoldColouredAndWhereItWasSeen) {
  const SurfaceCutOptions options = ball_options();
  const SurfaceCut cut = cut_of(ball_views(), options);
  const TriangleMesh& mesh = cut.mesh;
  ASSERT_GT(mesh.triangles.size(), 5000U);
  EXPECT_TRUE(topology(mesh).closed_manifold());
  EXPECT_NEAR(testing::volume(mesh), 4.0 / 3 * M_PI, 0.05);
  const auto errors = sorted_errors(mesh, [](const Eigen::Vector3d& p) { return p.norm() - 1; });
  EXPECT_LT(errors[errors.size() / 2], 0.15 * options.voxel_size);
  EXPECT_LT(errors.back(), options.voxel_size);
  ASSERT_EQ(mesh.normals.size(), mesh.vertices.size());
  ASSERT_EQ(mesh.colours.size(), mesh.vertices.size());
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Vector3f& v = mesh.vertices[i];
    EXPECT_GT(v.normalized().dot(mesh.normals[i]), 0.85);
    if (std::abs(v.z()) < 0.1) continue;
    EXPECT_GT(v.z() > 0 ? mesh.colours[i].r : mesh.colours[i].b, 200) << v.transpose();
  }
  const SurfaceCutStatistics& s = cut.statistics;
  EXPECT_EQ(s.voxels, 60U * 60U * 60U);
  EXPECT_GT(s.crust_voxels, 20000U);
  EXPECT_LT(s.crust_voxels, s.voxels / 2);
  EXPECT_GT(s.points, 10000U);
  EXPECT_GT(s.peak_bytes, 21 * s.crust_voxels);
}

TEST(SurfaceCut, NoiseOfAVoxelLeavesAClosedSurfaceWithoutBias) {
  const SurfaceCutOptions options = ball_options();
  const SurfaceCut cut = cut_of(ball_views(24, options.voxel_size), options);
  EXPECT_TRUE(topology(cut.mesh).closed_manifold());
  const auto errors =
      sorted_errors(cut.mesh, [](const Eigen::Vector3d& p) { return p.norm() - 1; });
  EXPECT_LT(errors[errors.size() / 2], 0.5 * options.voxel_size);
  EXPECT_NEAR(testing::volume(cut.mesh), 4.0 / 3 * M_PI, 0.12);
}

TEST(SurfaceCut, WithoutACostOfVolumeVotesAndLabelsAloneHoldTheSurface) {
  SurfaceCutOptions options = ball_options();
  options.ballooning = 0;
  const SurfaceCut cut = cut_of(ball_views(), options);
  EXPECT_TRUE(topology(cut.mesh).closed_manifold());
  EXPECT_NEAR(testing::volume(cut.mesh), 4.0 / 3 * M_PI, 0.15);
}

TEST(SurfaceCut, AHoleInTheMeasurementsIsClosedByASmallSurface) {
  // No ray meets the ball's top cap, 0.6 wide.
  Views views = ball_views();
  for (DepthMap& map : views.maps) {
    for (int y = 0; y < 100; ++y) {
      for (int x = 0; x < 100; ++x) {
        const Eigen::Vector3d ray((x - map.camera.cx_px) / map.camera.fx_px,
                                  (y - map.camera.cy_px) / map.camera.fy_px, 1);
        const Eigen::Vector3d p = map.T_world_camera * (ray * map.depth(x, y));
        if (p.z() > 0 && p.head<2>().norm() < 0.3) map.depth(x, y) = 0;
      }
    }
  }
  const SurfaceCut cut = cut_of(views, ball_options());
  EXPECT_TRUE(topology(cut.mesh).closed_manifold());
  EXPECT_NEAR(testing::volume(cut.mesh), 4.0 / 3 * M_PI, 0.1);
  for (const auto& v : cut.mesh.vertices) EXPECT_NEAR(v.norm(), 1, 0.25);
}

TEST(SurfaceCut, TheSameInputsGiveTheSameBitsWithAnyNumberOfThreads) {
  const Views views = ball_views(12, 0.03);
  SurfaceCutOptions options = ball_options(0.06);
  options.threads = 1;
  const TriangleMesh one = cut_of(views, options).mesh;
  for (const int threads : {1, 2, 5}) {
    options.threads = threads;
    const TriangleMesh other = cut_of(views, options).mesh;
    EXPECT_EQ(one.vertices, other.vertices);
    EXPECT_EQ(one.normals, other.normals);
    EXPECT_EQ(one.colours, other.colours);
    EXPECT_EQ(one.triangles, other.triangles);
  }
}

/// A plane z = 0.31, seen from above by cameras that look at its middle; it goes on for ever.
Views ground_views() {
  PlaneScene scene;
  scene.planes = {{Eigen::Vector3d(0, 0, 1), 0.31}};
  const Camera camera = testing::pinhole(120, 90, 70);
  Views out;
  for (int i = 0; i < 9; ++i) {
    const Pose T = looking_at({1.4 * (i % 3 - 1), 1.4 * (i / 3 - 1), 4}, {0.2, -0.1, 0.31});
    out.maps.push_back(depth_map(camera, T, scene.depth(camera, T)));
  }
  return out;
}

TEST(SurfaceCut, GroundReachesTheBordersOfTheVolumeAndIsCapped) {
  SurfaceCutOptions options;
  options.voxel_size = 0.05;
  options.box =
      Eigen::AlignedBox3d(Eigen::Vector3d(-1.5, -1.2, -0.7), Eigen::Vector3d(1.5, 1.2, 1));
  const TriangleMesh closed = cut_of(ground_views(), options).mesh;
  EXPECT_TRUE(topology(closed).closed_manifold());
  EXPECT_NEAR(testing::volume(closed), 3.0 * 2.4 * (0.31 + 0.7), 0.1)
      << "all of the volume below the ground, up to its borders";
  options.closed = false;
  const TriangleMesh open = cut_of(ground_views(), options).mesh;
  double area = 0;
  for (const auto& f : open.triangles) {
    const Eigen::Vector3f a = open.vertices[f[0]], b = open.vertices[f[1]], c = open.vertices[f[2]];
    area += 0.5 * (b - a).cross(c - a).norm();
  }
  EXPECT_NEAR(area, 2.95 * 2.35, 0.02) << "to the middles of the outermost voxels";
  const auto errors = sorted_errors(open, [](const Eigen::Vector3d& p) { return p.z() - 0.31; });
  EXPECT_LT(errors.back(), 0.1 * options.voxel_size);
  const testing::Topology t = topology(open);
  EXPECT_GT(t.open_edges, 0);
  EXPECT_EQ(t.crowded_edges + t.turned_edges + t.degenerate_faces, 0);
}

TEST(SurfaceCut, TheVolumeFollowsThePointsAndLeavesOutStrays) {
  Views views = ball_views();
  for (std::size_t i = 0; i < views.maps.size(); ++i)
    views.maps[i].depth(3, 3) = 500;  // background
  for (auto& map : views.maps) map.confidence(3, 3) = 0.9F;
  const SurfaceCut cut = cut_of(views, {});
  EXPECT_TRUE(topology(cut.mesh).closed_manifold());
  EXPECT_NEAR(testing::volume(cut.mesh), 4.0 / 3 * M_PI, 0.1);
  EXPECT_LT(cut.box.max().maxCoeff(), 1.5);
  EXPECT_GT(cut.box.max().minCoeff(), 1);
  EXPECT_NEAR(cut.voxel_size, 2.5 / 120, 0.005);
}

/// Finds out how near points are to others.
class PointGrid {
 public:
  PointGrid(const std::vector<Eigen::Vector3d>& points, double cell) : cell_(cell) {
    for (const auto& p : points) cells_[key(p)].push_back(p);
  }
  /// @pre distance <= cell
  [[nodiscard]] bool any_within(const Eigen::Vector3d& p, double distance) const {
    for (int i = 0; i < 27; ++i) {
      const auto it =
          cells_.find(key(p + cell_ * Eigen::Vector3d(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1)));
      if (it == cells_.end()) continue;
      for (const auto& q : it->second) {
        if ((p - q).norm() <= distance) return true;
      }
    }
    return false;
  }

 private:
  [[nodiscard]] std::array<int, 3> key(const Eigen::Vector3d& p) const {
    const Eigen::Vector3i k = (p / cell_).array().floor().cast<int>();
    return {k.x(), k.y(), k.z()};
  }
  double cell_;
  std::map<std::array<int, 3>, std::vector<Eigen::Vector3d>> cells_;
};

TEST(SurfaceCut, TheGroundOfTheSyntheticTownIsWholeUpToItsBorders) {
  FlightOptions flight_options;
  flight_options.width_px = 188;
  flight_options.height_px = 120;
  flight_options.duration_s = 8;
  flight_options.rate_hz = 2;
  flight_options.threads = 2;
  const SyntheticFlight flight(flight_options);
  Views views;
  std::vector<Eigen::Vector3d> points;
  for (std::size_t i = 0; i < flight.frame_count(); ++i) {
    views.maps.push_back(depth_map(flight.camera(), flight.true_pose(i), flight.render_depth(i)));
    const DepthMap& map = views.maps.back();
    for (int y = 0; y < map.depth.height(); ++y) {
      for (int x = 0; x < map.depth.width(); ++x) {
        if (!(map.depth(x, y) > 0)) continue;
        const Eigen::Vector3d ray = map.camera.unproject({x, y}).value();
        points.push_back(map.T_world_camera * (ray * (map.depth(x, y) / ray.z())));
      }
    }
  }
  SurfaceCutOptions options;
  options.voxel_size = 0.5;
  // A part of the town that the flight saw whole, so that the ground meets every side of it.
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const auto& p : points) middle += p / static_cast<double>(points.size());
  options.box = Eigen::AlignedBox3d(middle - Eigen::Vector3d(14, 14, 12),
                                    middle + Eigen::Vector3d(14, 14, 25));
  const SurfaceCut closed = cut_of(views, options);
  EXPECT_TRUE(topology(closed.mesh).closed_manifold());
  EXPECT_GT(testing::volume(closed.mesh), 0);

  options.closed = false;
  const TriangleMesh open = cut_of(views, options).mesh;
  std::vector<Eigen::Vector3d> vertices;
  for (const auto& v : open.vertices) vertices.push_back(v.cast<double>());
  const PointGrid near_point(points, 1), near_vertex(vertices, 1);
  std::size_t good = 0;
  for (const auto& v : vertices) good += near_point.any_within(v, 0.5 * options.voxel_size);
  EXPECT_GT(static_cast<double>(good), 0.75 * static_cast<double>(vertices.size()));
  // Ground: what lies hardly higher than the lowest point around.
  const auto column = [](const Eigen::Vector3d& p, int dx, int dy) {
    return std::array{static_cast<int>(std::floor(p.x() / 3)) + dx,
                      static_cast<int>(std::floor(p.y() / 3)) + dy};
  };
  std::map<std::array<int, 2>, double> lowest;
  for (const auto& p : points) {
    const auto it = lowest.try_emplace(column(p, 0, 0), p.z()).first;
    it->second = std::min(it->second, p.z());
  }
  const auto is_ground = [&](const Eigen::Vector3d& p) {
    for (int i = 0; i < 9; ++i) {
      const auto it = lowest.find(column(p, i % 3 - 1, i / 3 - 1));
      if (it != lowest.end() && p.z() > it->second + 0.5) return false;
    }
    return true;
  };
  std::size_t inside = 0, found = 0, at_border = 0, found_at_border = 0;
  for (const auto& p : points) {
    const double room = (closed.box.max() - p).cwiseMin(p - closed.box.min()).minCoeff();
    if (room < 0.5 * options.voxel_size) continue;  // the open mesh ends there
    const bool covered = near_vertex.any_within(p, 1.5 * options.voxel_size);
    ++inside;
    found += covered;
    if (room > 4 * options.voxel_size || !is_ground(p)) continue;
    ++at_border;
    found_at_border += covered;
  }
  ASSERT_GT(at_border, 1500U);
  EXPECT_GT(static_cast<double>(found), 0.96 * static_cast<double>(inside));
  EXPECT_GT(static_cast<double>(found_at_border), 0.995 * static_cast<double>(at_border));
}

TEST(SurfaceCut, BadInputIsRefusedInWords) {
  const Views views = ball_views(6);
  const auto error = [](const Views& v, const SurfaceCutOptions& options) {
    const auto cut = cut_surface(v.list(), options);
    return cut ? std::string("none") : cut.error().to_string();
  };
  EXPECT_NE(error({}, {}).find("no depth map"), std::string::npos);

  SurfaceCutOptions options = ball_options();
  options.box = Eigen::AlignedBox3d(Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(1, 0, 1));
  EXPECT_NE(error(views, options).find("volume is empty"), std::string::npos);
  options.box->max() = Eigen::Vector3d(-1, -1, -1);
  EXPECT_NE(error(views, options).find("volume is empty"), std::string::npos);
  options.box->max().x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(error(views, options).find("volume is empty"), std::string::npos);

  options = ball_options();
  options.box->translate(Eigen::Vector3d(100, 0, 0));
  EXPECT_NE(error(views, options).find("has a point in the volume"), std::string::npos);
  options = ball_options();
  options.voxel_size = 0.05 / 1000;
  EXPECT_NE(error(views, options).find("more than the"), std::string::npos);
  options.voxel_size = 0.05 * 1000;
  EXPECT_NE(error(views, options).find("less than two voxels"), std::string::npos);
  options.voxel_size = -1;
  EXPECT_NE(error(views, options).find("voxel size"), std::string::npos);
  options = ball_options();
  options.max_bytes = 1 << 20;
  EXPECT_NE(error(views, options).find("MB allowed"), std::string::npos);
  options = ball_options();
  options.box->translate(Eigen::Vector3d(1e7, 0, 0));
  EXPECT_NE(error(moved(views, {1e7, 0, 0}), options).find("from the origin"), std::string::npos);
  options = ball_options();  // a long one that begins near it
  options.box =
      Eigen::AlignedBox3d(Eigen::Vector3d(-1.5, -0.1, -0.1), Eigen::Vector3d(6500, 0.1, 0.1));
  EXPECT_NE(error(views, options).find("from the origin"), std::string::npos);

  Views bad = ball_views(6);
  bad.maps[2].T_world_camera =
      Pose(Eigen::Quaterniond::Identity(),
           Eigen::Vector3d(std::numeric_limits<double>::quiet_NaN(), 0, 0));
  EXPECT_NE(error(bad, ball_options()).find("pose"), std::string::npos);
  bad = ball_views(6);
  bad.maps[1].confidence = FloatImage(3, 3);
  EXPECT_NE(error(bad, ball_options()).find("another size"), std::string::npos);
  bad = ball_views(6);
  bad.maps[1].camera.fx_px = 0;
  EXPECT_NE(error(bad, ball_options()).find("pinhole"), std::string::npos);
  bad = ball_views(6);
  for (DepthMap& map : bad.maps) {
    std::fill(map.depth.data(), map.depth.data() + map.depth.size(), 0.F);
  }
  EXPECT_NE(error(bad, {}).find("no points"), std::string::npos);
  EXPECT_NE(error(bad, ball_options()).find("has a point in the volume"), std::string::npos);
}

TEST(SurfaceCut, BrokenDepthsAreNoAnswers) {
  Views views = ball_views();
  const float values[] = {std::numeric_limits<float>::quiet_NaN(),
                          std::numeric_limits<float>::infinity(), -5.F, 1e35F, 1e-30F};
  std::mt19937 random(2);
  for (DepthMap& map : views.maps) {
    for (int i = 0; i < 300; ++i) {
      map.depth(static_cast<int>(random() % 100), static_cast<int>(random() % 100)) =
          values[random() % 5];
      map.confidence(static_cast<int>(random() % 100), static_cast<int>(random() % 100)) =
          values[random() % 3];
    }
  }
  const SurfaceCut cut = cut_of(views, ball_options());
  EXPECT_TRUE(topology(cut.mesh).closed_manifold());
  EXPECT_NEAR(testing::volume(cut.mesh), 4.0 / 3 * M_PI, 0.1);
  for (const auto& v : cut.mesh.vertices) EXPECT_TRUE(v.allFinite());
}

TEST(SurfaceCut, TakesLargerVoxelsWhereMemoryIsShort) {
  SurfaceCutOptions options = ball_options(0.02);
  options.max_bytes = 4 << 20;
  options.coarsen = true;
  const SurfaceCut cut = cut_of(ball_views(), options);
  EXPECT_GT(cut.voxel_size, 0.03);
  EXPECT_LE(cut.statistics.peak_bytes, options.max_bytes);
  EXPECT_TRUE(topology(cut.mesh).closed_manifold());
  EXPECT_NEAR(testing::volume(cut.mesh), 4.0 / 3 * M_PI, 0.15);
}

TEST(SurfaceCut, LargerVoxelsKeepTheWholeVolume) {
  // Far more voxels than an int holds, and too far from the origin before they are larger.
  const Eigen::Vector3d away(1000, 0, 0);
  SurfaceCutOptions options = ball_options(1e-9);
  options.box->translate(away);
  options.max_bytes = 4 << 20;
  options.coarsen = true;
  const SurfaceCut cut = cut_of(moved(ball_views(), away), options);
  EXPECT_TRUE(cut.box.contains(*options.box));
  EXPECT_LT((cut.box.sizes() - options.box->sizes()).maxCoeff(), 2 * cut.voxel_size);
  EXPECT_NEAR(testing::volume(cut.mesh), 4.0 / 3 * M_PI, 0.15);
}

TEST(SurfaceCut, StopsWhenAsked) {
  const Views views = ball_views(6);
  for (const std::string_view last : {"points", "votes", "flow", "colours"}) {
    std::stop_source stop;
    SurfaceCutControl control{stop.get_token(), [&](std::string_view stage) {
                                if (stage == last) stop.request_stop();
                              }};
    const auto cut = cut_surface(views.list(), ball_options(), control);
    ASSERT_FALSE(cut.has_value());
    EXPECT_EQ(cut.error().code, ErrorCode::interrupted);
  }
}

}  // namespace
}  // namespace corvid
