#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <string>

#include "corvid/map.h"

namespace corvid::test {

constexpr std::int64_t kMs = 1'000'000;

/// Metric, at a similarity that hides no mistake.
inline std::shared_ptr<MapPlacement> some_placement(double scale = 2.5) {
  auto placement = std::make_shared<MapPlacement>();
  placement->scale = MapScale::metric;
  placement->origin = {47.4, 8.5, 488};
  placement->T_enu_map = Sim3(scale, so3_exp({0.3, -0.8, 1.1}), {10, -20, 30});
  const Eigen::Vector<double, 7> sigma(0.02, 0.03, 0.01, 0.002, 0.003, 0.004, 0.005);
  placement->covariance = sigma.cwiseAbs2().asDiagonal();
  return placement;
}

inline Matrix6d some_covariance() {
  Matrix6d A;
  for (int i = 0; i < 36; ++i) A(i / 6, i % 6) = std::sin(1.7 * i + 0.3);
  return 1e-4 * (A * A.transpose() + Matrix6d::Identity());
}

/// A tracked frame of a map with metric scale.
inline PoseEvent tracked(std::int64_t time_ns, const Pose& T_world_camera,
                         std::shared_ptr<const MapPlacement> placement = some_placement()) {
  PoseEvent event;
  event.time_ns = time_ns;
  event.state = TrackingState::tracking;
  event.T_world_camera = T_world_camera;
  event.covariance = some_covariance();
  event.scale = placement->scale;
  event.placement = std::move(placement);
  return event;
}

inline PoseEvent lost(std::int64_t time_ns, std::string reason) {
  PoseEvent event;
  event.time_ns = time_ns;
  event.state = TrackingState::lost;
  event.reason = std::move(reason);
  return event;
}

/// Constant velocity [map units / s] and angular rate in the camera [rad/s].
struct SteadyFlight {
  Eigen::Vector3d v{1, 0.5, -0.3}, omega{0.1, -0.2, 0.3};
  [[nodiscard]] Pose at(double t_s) const {
    return {so3_exp({0.4, 0.1, -0.6}) * so3_exp(omega * t_s), Eigen::Vector3d(5, 6, 7) + v * t_s};
  }
};

}  // namespace corvid::test
