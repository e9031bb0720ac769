#include "replay/synthetic_flight.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "core/median.h"
#include "oracle/ray_mesh.h"
#include "replay/random.h"
#include "scenes/rendered_views.h"

namespace corvid {
namespace {
using scenes::RenderedView;

FlightOptions tiny(FlightPath path = FlightPath::survey) {
  FlightOptions options = scenes::small_flight(path);
  options.width_px = 160;
  options.height_px = 112;
  options.duration_s = 4;
  return options;
}

TEST(SyntheticFlight, ThreadsDoNotChangeAByte) {
  FlightOptions options = tiny();
  options.shutter_s = 0.01;
  options.threads = 1;
  const SyntheticFlight one(options);
  options.threads = 3;
  const SyntheticFlight three(options);
  for (const std::size_t frame : {0u, 37u}) {
    EXPECT_EQ(one.render(frame)->grey, three.render(frame)->grey);
    EXPECT_EQ(one.render(frame)->colour, three.render(frame)->colour);
    EXPECT_EQ(one.render_depth(frame), three.render_depth(frame));
  }
}

TEST(SyntheticFlight, TheSeedDecidesEverything) {
  FlightOptions options = tiny();
  const SyntheticFlight a(options), b(options);
  options.seed = 2;
  const SyntheticFlight other(options);
  EXPECT_EQ(a.render(5)->grey, b.render(5)->grey);
  EXPECT_NE(a.render(5)->grey, other.render(5)->grey);
  EXPECT_NE(a.true_pose(5).translation(), other.true_pose(5).translation());
}

TEST(SyntheticFlight, StreamsItsFramesInOrder) {
  FlightOptions options = tiny();
  options.rate_hz = 10;
  options.duration_s = 0.5;
  options.start_time_ns = 7'000'000'000;
  SyntheticFlight flight(options);
  EXPECT_EQ(flight.info().frames, 5u);
  EXPECT_EQ(flight.info().rate_hz, 10);
  EXPECT_TRUE(flight.info().colour);
  const Trajectory truth = flight.truth();
  ASSERT_EQ(truth.size(), 5u);
  for (std::size_t i = 0; i < 5; ++i) {
    const auto frame = flight.next();
    ASSERT_TRUE(frame.has_value());
    ASSERT_NE(*frame, nullptr);
    EXPECT_EQ((*frame)->id, FrameId(static_cast<std::uint32_t>(i)));
    EXPECT_EQ((*frame)->time_ns, 7'000'000'000 + static_cast<std::int64_t>(i) * 100'000'000);
    EXPECT_EQ((*frame)->grey, flight.render(i)->grey);
    EXPECT_EQ(truth[i].time_ns, (*frame)->time_ns);
    EXPECT_EQ(truth[i].T_world_camera.matrix(), flight.true_pose(i).matrix());
  }
  EXPECT_EQ(flight.next().value(), nullptr);
  EXPECT_EQ(flight.counts().delivered, 5u);
  EXPECT_EQ(flight.counts().skipped, 0u);
}

TEST(SyntheticFlight, GreyCamerasHaveNoColour) {
  FlightOptions options = tiny();
  const GreyImage grey = SyntheticFlight(options).render(0)->grey;
  options.colour = false;
  const SyntheticFlight flight(options);
  EXPECT_TRUE(flight.render(0)->colour.empty());
  EXPECT_FALSE(flight.info().colour);
  EXPECT_EQ(flight.render(0)->grey, grey);
}

TEST(SyntheticFlight, WrongOptionsAreListed) {
  FlightOptions options;
  options.width_px = 3;
  options.rate_hz = 0;
  options.noise_sigma = std::nan("");
  const auto flight = SyntheticFlight::open(options);
  ASSERT_FALSE(flight.has_value());
  EXPECT_EQ(flight.error().code, ErrorCode::invalid_argument);
  EXPECT_THAT(flight.error().what,
              testing::AllOf(testing::HasSubstr("width_px"), testing::HasSubstr("rate_hz"),
                             testing::HasSubstr("noise_sigma")));
  EXPECT_THROW(SyntheticFlight{options}, std::logic_error);
  EXPECT_TRUE(SyntheticFlight::open(tiny()).has_value());
}

TEST(SyntheticFlight, DepthsOfTwoViewsAgree) {
  // A point that one view sees can be hidden from another one, but never be in front of what the
  // other one sees; most points are seen by both, at the same depth.
  for (const FlightPath path : {FlightPath::survey, FlightPath::facade, FlightPath::orbit}) {
    const auto views = scenes::rendered_views(2, 10, scenes::small_flight(path));
    int both = 0, hidden = 0, in_front = 0;
    double worst = 0;
    for (int y = 0; y < 240; y += 2)
      for (int x = 0; x < 320; x += 2) {
        const auto p = scenes::point_at(views[0], x, y);
        const auto seen = p ? scenes::sight(views[1], *p) : std::nullopt;
        if (!seen) continue;
        const double error = seen->z / seen->seen_z - 1;
        if (std::abs(error) < 1e-4) {
          ++both;
          worst = std::max(worst, std::abs(error));
        } else {
          ++(error > 0 ? hidden : in_front);
        }
      }
    EXPECT_GT(both, 3000) << static_cast<int>(path);
    EXPECT_LT(hidden, both / 5) << static_cast<int>(path);
    EXPECT_LT(in_front, both / 100) << static_cast<int>(path);  // things narrower than a pixel
    EXPECT_LT(worst, 1e-4);
  }
}

TEST(SyntheticFlight, SurfacePointsLookTheSameInEveryFrame) {
  FlightOptions options = scenes::small_flight();
  options.noise_sigma = 0;
  const auto views = scenes::rendered_views(2, 4, options);
  const auto difference = [&](double planted_error_m) {
    RenderedView second = views[1];
    std::vector<double> differences;
    for (int y = 0; y < 240; y += 2)
      for (int x = 0; x < 320; x += 2) {
        const auto p = scenes::point_at(views[0], x, y);
        if (!p) continue;
        const Eigen::Vector3d moved = *p + Eigen::Vector3d(planted_error_m, 0, 0);
        const auto seen = scenes::sight(second, moved);
        if (!seen || seen->z > 1.01 * seen->seen_z) continue;
        differences.push_back(std::abs(scenes::grey_at(second.frame->grey, seen->pixel) -
                                       views[0].frame->grey(x, y)));
      }
    EXPECT_GT(differences.size(), 5000u);
    return upper_median(differences);
  };
  const double right = difference(0), wrong = difference(0.3);
  EXPECT_LT(right, 1.5) << "[grey levels]";
  EXPECT_GT(wrong, 2 * right) << "[grey levels]";
}

TEST(SyntheticFlight, PatternsAreFilteredNotSampled) {
  // The mean of 4 x 4 pixels of a picture four times as sharp is the pixel of the coarse one.
  FlightOptions options = tiny();
  options.noise_sigma = 0;
  options.optical_blur_px = 0;
  const SyntheticFlight coarse(options);
  options.width_px *= 4;
  options.height_px *= 4;
  const SyntheticFlight fine(options);
  const GreyImage small = coarse.render(0)->grey, large = fine.render(0)->grey;
  std::vector<double> filtered, sampled;
  for (int y = 0; y < small.height(); ++y)
    for (int x = 0; x < small.width(); ++x) {
      double light = 0;  // levels are square roots of light
      for (int j = 0; j < 4; ++j)
        for (int i = 0; i < 4; ++i) light += std::pow(large(4 * x + i, 4 * y + j), 2) / 16;
      filtered.push_back(std::abs(std::sqrt(light) - small(x, y)));
      sampled.push_back(std::abs(large(4 * x + 2, 4 * y + 2) - small(x, y)));
    }
  EXPECT_LT(upper_median(filtered), 2.0) << "[grey levels]";
  EXPECT_LT(upper_median(filtered), 0.6 * upper_median(sampled));
}

TEST(SyntheticFlight, EveryLensSeesTheTrueSurface) {
  for (const CameraModel model :
       {CameraModel::pinhole, CameraModel::radtan, CameraModel::equidistant, CameraModel::fov}) {
    FlightOptions options = tiny();
    options.model = model;
    options.horizontal_fov_rad = 1.6;
    const SyntheticFlight flight(options);
    ASSERT_EQ(flight.camera().validate(), "");
    const TriangleMesh mesh = *flight.true_surface();
    const FloatImage depth = flight.render_depth(0);
    const Pose T = flight.true_pose(0);
    Random random(7);
    int compared = 0;
    for (int i = 0; i < 60; ++i) {
      const int x = random.below(options.width_px), y = random.below(options.height_px);
      const auto ray = flight.camera().unproject({x, y});
      ASSERT_TRUE(ray.has_value());
      const Eigen::Vector3d along = T.R() * (*ray / ray->z());
      const double t = oracle::first_hit(mesh, T.translation(), along).t;
      if (depth(x, y) == 0) {
        EXPECT_TRUE(std::isinf(t));
        continue;
      }
      // The mesh has floats, the renderer doubles.
      EXPECT_NEAR(static_cast<double>(depth(x, y)), t, 2e-3)
          << to_string(model) << ' ' << x << ' ' << y;
      ++compared;
    }
    EXPECT_GT(compared, 50);
  }
}

TEST(SyntheticFlight, TheTrueSurfaceIsSound) {
  const SyntheticFlight flight(tiny());
  const TriangleMesh mesh = *flight.true_surface();
  int degenerate = 0;
  for (const auto& triangle : mesh.triangles) {
    for (const std::uint32_t vertex : triangle) ASSERT_LT(vertex, mesh.vertices.size());
    const Eigen::Vector3f a = mesh.vertices[triangle[0]];
    const Eigen::Vector3f n =
        (mesh.vertices[triangle[1]] - a).cross(mesh.vertices[triangle[2]] - a);
    degenerate += n.norm() < 1e-6f;
  }
  EXPECT_GT(mesh.triangles.size(), 60000u);
  EXPECT_LT(degenerate, 100);
  for (const Eigen::Vector3f& v : mesh.vertices) ASSERT_TRUE(v.allFinite());
  Random random(3);
  for (int i = 0; i < 60; ++i) {  // from outside, triangles are seen from their front
    const Eigen::Vector3d from(random.uniform(-130, 130), random.uniform(-130, 130), 90);
    const Eigen::Vector3d ray(random.uniform(-0.7, 0.7), random.uniform(-0.7, 0.7), -1);
    const oracle::MeshHit hit = oracle::first_hit(mesh, from, ray);
    ASSERT_TRUE(std::isfinite(hit.t));
    const auto& corner = mesh.triangles[hit.triangle];
    const Eigen::Vector3f a = mesh.vertices[corner[0]];
    const Eigen::Vector3f n = (mesh.vertices[corner[1]] - a).cross(mesh.vertices[corner[2]] - a);
    EXPECT_LT(n.cast<double>().dot(ray), 0);
  }
}

TEST(SyntheticFlight, ALoopEndsExactlyWhereItBegan) {
  for (const double duration : {3.0, 20.0, 200.0}) {
    FlightOptions options = tiny(FlightPath::loop);
    options.duration_s = duration;
    const SyntheticFlight flight(options);
    const Trajectory truth = flight.truth();
    EXPECT_EQ(truth.front().T_world_camera.matrix(), truth.back().T_world_camera.matrix());
    double length = 0;
    for (std::size_t i = 1; i < truth.size(); ++i)
      length += (truth[i].T_world_camera.translation() - truth[i - 1].T_world_camera.translation())
                    .norm();
    EXPECT_NEAR(length / (7 * (duration - 0.05)), 1, 0.1);
  }
}

TEST(SyntheticFlight, PathsMoveAsTheyShould) {
  const auto path_of = [](FlightPath path, double duration_s) {
    FlightOptions options = tiny(path);
    options.duration_s = duration_s;
    return SyntheticFlight(options).truth();
  };
  const auto step = [](const Trajectory& t, std::size_t i) {
    return t[i - 1].T_world_camera.inverse() * t[i].T_world_camera;
  };
  for (const FlightPath path :
       {FlightPath::survey, FlightPath::orbit, FlightPath::nadir, FlightPath::facade}) {
    const Trajectory truth = path_of(path, 300);
    double fastest = 0, sharpest = 0, jerk = 0;
    for (std::size_t i = 2; i < truth.size(); ++i) {
      const Pose now = step(truth, i), before = step(truth, i - 1);
      fastest = std::max(fastest, now.translation().norm());
      sharpest = std::max(sharpest, so3_log(now.rotation()).norm());
      jerk = std::max(jerk, (before.inverse() * now).log().norm());
    }
    EXPECT_LT(fastest, 0.5) << static_cast<int>(path);    // [m per frame]
    EXPECT_LT(sharpest, 0.02) << static_cast<int>(path);  // [rad per frame]
    EXPECT_LT(jerk, 0.01) << static_cast<int>(path);      // no corners
    EXPECT_GT(
        (truth[200].T_world_camera.translation() - truth[0].T_world_camera.translation()).norm(),
        5);
  }
  const Trajectory hover = path_of(FlightPath::hover, 2),
                   rotation = path_of(FlightPath::rotation, 2);
  EXPECT_EQ(hover.front().T_world_camera.matrix(), hover.back().T_world_camera.matrix());
  EXPECT_EQ(rotation.front().T_world_camera.translation(),
            rotation.back().T_world_camera.translation());
  EXPECT_GT(
      so3_log(
          (rotation.front().T_world_camera.inverse() * rotation.back().T_world_camera).rotation())
          .norm(),
      0.2);
}

TEST(SyntheticFlight, ASurveyMovesSlowlyEnoughToTrackAndFillsTheImage) {
  FlightOptions options;  // the default, at a quarter of its size
  options.width_px /= 4;
  options.height_px /= 4;
  for (const int first : {0, 200, 390}) {
    const auto views = scenes::rendered_views(2, 1, options, first);
    double fastest = 0;
    int points = 0, with_texture = 0;
    for (int y = 2; y < options.height_px - 2; ++y)
      for (int x = 2; x < options.width_px - 2; ++x) {
        const auto p = scenes::point_at(views[0], x, y);
        if (!p) continue;
        const auto pixel = views[1].frame->camera->project(views[1].T_world_camera.inverse() * *p);
        ASSERT_TRUE(pixel.has_value());
        fastest = std::max(fastest, 4 * (*pixel - Eigen::Vector2d(x, y)).norm());
        ++points;
        const GreyImage& grey = views[0].frame->grey;
        with_texture +=
            std::abs(grey(x + 2, y) - grey(x - 2, y)) + std::abs(grey(x, y + 2) - grey(x, y - 2)) >
            6;
      }
    EXPECT_EQ(points, (options.width_px - 4) * (options.height_px - 4));  // no sky
    EXPECT_LT(fastest, 12) << "[px per frame at full size]";
    EXPECT_GT(with_texture, points / 2);
  }
}

TEST(SyntheticFlight, TheSensorIsAsOrdered) {
  FlightOptions options = tiny(FlightPath::hover);
  options.noise_sigma = 0;
  const GreyImage clean = SyntheticFlight(options).render(0)->grey;
  EXPECT_EQ(clean, SyntheticFlight(options).render(1)->grey);
  options.noise_sigma = 3;
  const SyntheticFlight noisy(options);
  const GreyImage first = noisy.render(0)->grey;
  double sum = 0, squares = 0;
  for (std::size_t i = 0; i < clean.size(); ++i) {
    const double d = first.data()[i] - static_cast<double>(clean.data()[i]);
    sum += d;
    squares += d * d;
  }
  const double n = static_cast<double>(clean.size());
  EXPECT_NEAR(sum / n, 0, 0.1);
  EXPECT_NEAR(std::sqrt(squares / n), 3, 0.15);
  EXPECT_NE(first, noisy.render(1)->grey);

  options.noise_sigma = 0;
  options.vignetting = 0.5;
  const GreyImage dark = SyntheticFlight(options).render(0)->grey;
  EXPECT_NEAR(dark(0, 0), clean(0, 0) * std::sqrt(0.5), 2);
  EXPECT_NEAR(dark(80, 56), clean(80, 56), 1);
  options.vignetting = 0;
  options.exposure_change = 0.3;
  options.duration_s = 20;
  const SyntheticFlight changing(options);
  std::set<std::uint8_t> levels;
  for (std::size_t frame = 0; frame < 400; frame += 40)
    levels.insert(changing.render(frame)->grey(80, 56));
  EXPECT_GT(*levels.rbegin() - *levels.begin(), 10);
}

TEST(SyntheticFlight, AnOpenShutterBlursAlongTheMotion) {
  FlightOptions options = tiny();
  options.noise_sigma = 0;
  const GreyImage sharp = SyntheticFlight(options).render(10)->grey;
  options.shutter_s = 0.3;
  const GreyImage blurred = SyntheticFlight(options).render(10)->grey;
  const auto contrast = [](const GreyImage& image) {
    double sum = 0;
    for (int y = 0; y + 1 < image.height(); ++y)
      for (int x = 0; x < image.width(); ++x) sum += std::abs(image(x, y + 1) - image(x, y));
    return sum;
  };
  EXPECT_LT(contrast(blurred), 0.8 * contrast(sharp));
}

}  // namespace
}  // namespace corvid
