#pragma once

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <optional>
#include <stdexcept>
#include <vector>

#include "kernels/device.h"
#include "replay/synthetic_flight.h"

namespace corvid::test {

inline std::shared_ptr<Device> device() {
  const char* choice = std::getenv("CORVID_TEST_DEVICE");
  static const auto opened = Device::open(choice ? choice : "auto");
  if (!opened) throw std::runtime_error(opened.error().to_string());
  return *opened;
}

inline FlightOptions small_flight() {
  FlightOptions options;
  options.width_px = 480;
  options.height_px = 320;
  options.colour = false;
  options.duration_s = 4;
  return options;
}

/// Where a feature that is seen at `x_a` from one pose is seen from another. Nothing at the edge of
/// the depth image and at depth edges, where a feature has two depths.
inline std::optional<Eigen::Vector2d> true_place(const SyntheticFlight& flight,
                                                 const Pose& T_world_a, const FloatImage& depth_a,
                                                 const Eigen::Vector2d& x_a,
                                                 const Pose& T_world_b) {
  const Camera& camera = flight.camera();
  const int u = static_cast<int>(std::lround(x_a.x())), v = static_cast<int>(std::lround(x_a.y()));
  if (!depth_a.contains(u, v, 3)) return std::nullopt;
  const double z = depth_a(u, v);
  for (int dy = -3; dy <= 3; ++dy)
    for (int dx = -3; dx <= 3; ++dx)
      if (std::abs(depth_a(u + dx, v + dy) - z) > 0.03 * z) return std::nullopt;
  const auto ray = camera.unproject(x_a);
  if (!ray || z <= 0) return std::nullopt;
  return camera.project(T_world_b.inverse() * (T_world_a * (*ray * (z / ray->z()))));
}

/// 0 <= q <= 1; throws if there are no values.
inline double quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values.at(static_cast<std::size_t>(q * static_cast<double>(values.size() - 1)));
}

/// Distances [px] between where features were found and where the rendered scene says that they are
/// (true_place()). Features that are hidden there count with the distance to where they would be.
struct TruthErrors {
  std::vector<double> px;

  void add(const SyntheticFlight& flight, const Pose& T_world_a, const FloatImage& depth_a,
           const Eigen::Vector2d& x_a, const Pose& T_world_b, const Eigen::Vector2d& x_b) {
    const auto x = true_place(flight, T_world_a, depth_a, x_a, T_world_b);
    if (x) px.push_back((*x - x_b).norm());
  }
  [[nodiscard]] double quantile(double q) const { return test::quantile(px, q); }
  [[nodiscard]] double share_above(double limit_px) const {
    const auto above = std::count_if(px.begin(), px.end(), [&](double e) { return e > limit_px; });
    return static_cast<double>(above) / static_cast<double>(std::max<std::size_t>(1, px.size()));
  }
};

}  // namespace corvid::test
