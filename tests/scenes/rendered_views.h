#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "replay/synthetic_flight.h"

namespace corvid::scenes {

/// One picture of the synthetic town with its exact truth [m].
struct RenderedView {
  FramePtr frame;
  Pose T_world_camera;
  FloatImage depth;  ///< z in camera coordinates [m]; 0 where there is sky
};

/// A small, quick flight: 320 x 240 pixels, mild noise, no vignetting, constant exposure.
[[nodiscard]] inline FlightOptions small_flight(FlightPath path = FlightPath::survey) {
  FlightOptions options;
  options.width_px = 320;
  options.height_px = 240;
  options.horizontal_fov_rad = 1.1;
  options.path = path;
  options.noise_sigma = 0.5;
  options.vignetting = 0;
  options.exposure_change = 0;
  return options;
}

/// `count` views, `step` frames apart (7 m/s at 20 Hz: 0.35 m per frame), from frame `first`.
[[nodiscard]] inline std::vector<RenderedView> rendered_views(
    int count, int step, const FlightOptions& options = small_flight(), int first = 0) {
  FlightOptions flight_options = options;
  flight_options.duration_s = (first + (count - 1) * step + 1) / options.rate_hz;
  const SyntheticFlight flight(flight_options);
  std::vector<RenderedView> views;
  for (int i = 0; i < count; ++i) {
    const auto frame = static_cast<std::size_t>(first + i * step);
    views.push_back({flight.render(frame), flight.true_pose(frame), flight.render_depth(frame)});
  }
  return views;
}

/// The point seen by pixel (x, y) of a view [m, world], nothing where there is sky.
[[nodiscard]] inline std::optional<Eigen::Vector3d> point_at(const RenderedView& view, int x,
                                                             int y) {
  const double z = static_cast<double>(view.depth(x, y));
  const auto ray = view.frame->camera->unproject({x, y});
  if (z <= 0 || !ray) return std::nullopt;
  return view.T_world_camera * Eigen::Vector3d(*ray * (z / ray->z()));
}

struct Sighting {
  Eigen::Vector2d pixel;
  double z = 0;       ///< depth of the point in the view [m]
  double seen_z = 0;  ///< depth of the surface that the view sees there [m]
};
/// Where a view sees a point, if the four pixels around it see one plane (1/z is linear in the
/// image of a plane under a pinhole camera); nothing at edges of surfaces and outside the image.
[[nodiscard]] inline std::optional<Sighting> sight(const RenderedView& view,
                                                   const Eigen::Vector3d& p_world) {
  const Eigen::Vector3d p = view.T_world_camera.inverse() * p_world;
  const auto pixel = view.frame->camera->project(p);
  if (!pixel || !view.frame->camera->in_image(*pixel, 2)) return std::nullopt;
  const int x = static_cast<int>(pixel->x()), y = static_cast<int>(pixel->y());
  const auto inverse = [&](int i, int j) { return 1.0 / static_cast<double>(view.depth(i, j)); };
  const double a = inverse(x, y), b = inverse(x + 1, y), c = inverse(x, y + 1);
  const double d = inverse(x + 1, y + 1);
  const double bend = std::abs(a + d - b - c), tilt = std::abs(b - a) + std::abs(c - a);
  if (!(bend < 1e-6 * a + 1e-3 * tilt)) return std::nullopt;
  const double fx = pixel->x() - x, fy = pixel->y() - y;
  return Sighting{*pixel, p.z(), 1 / (a + fx * (b - a) + fy * (c - a))};
}

/// Grey level between pixels, bilinear. The pixel must lie at least 1 px inside the image.
[[nodiscard]] inline double grey_at(const GreyImage& image, const Eigen::Vector2d& pixel) {
  const int x = static_cast<int>(pixel.x()), y = static_cast<int>(pixel.y());
  const double fx = pixel.x() - x, fy = pixel.y() - y;
  return (1 - fy) * ((1 - fx) * image(x, y) + fx * image(x + 1, y)) +
         fy * ((1 - fx) * image(x, y + 1) + fx * image(x + 1, y + 1));
}

}  // namespace corvid::scenes
