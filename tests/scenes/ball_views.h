#pragma once

#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "mapping/still_depth.h"
#include "scenes/plane_views.h"

namespace corvid::testing {

/// A ball of radius 0.7 at (0, 0, 3) before a wall at z = 4.5, seen from an arc; all look at it.
inline std::vector<StillView> ball_views(int count) {
  PlaneScene scene;
  scene.planes = {{Eigen::Vector3d(0, 0, 1), 4.5}};
  scene.spheres = {{Eigen::Vector3d(0, 0, 3), 0.7}};
  scene.finest = 0.07;
  const auto camera = std::make_shared<const Camera>(pinhole(160, 120, 150));
  std::vector<StillView> views;
  for (int i = 0; i < count; ++i) {
    const double angle = 0.09 * (i - 0.5 * (count - 1));
    const Pose T(so3_exp({0, angle, 0}),
                 Eigen::Vector3d(-3 * std::sin(angle), 0, 3 - 3 * std::cos(angle)));
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(i));
    frame->grey = scene.render(*camera, T);
    frame->camera = camera;
    views.push_back({frame, T});
  }
  return views;
}

/// Distance of a point from that wall or ball, whichever is nearer.
inline double off_ball_and_wall(const Eigen::Vector3f& p) {
  const Eigen::Vector3d q = p.cast<double>();
  return std::min(std::abs(q.z() - 4.5), std::abs((q - Eigen::Vector3d(0, 0, 3)).norm() - 0.7));
}

/// A line of a Middlebury *_par.txt: name, K, R and t, by rows.
inline std::string middlebury_line(const std::string& name, const StillView& view) {
  const Camera& c = *view.frame->camera;
  std::string line =
      fmt::format("{} {} 0 {} 0 {} {} 0 0 1", name, c.fx_px, c.cx_px, c.fy_px, c.cy_px);
  const Pose T = view.T_world_camera.inverse();
  const Eigen::Matrix3d R = T.R();
  for (int i = 0; i < 9; ++i) line += fmt::format(" {}", R(i / 3, i % 3));
  for (int i = 0; i < 3; ++i) line += fmt::format(" {}", T.translation()(i));
  return line + "\n";
}

}  // namespace corvid::testing
