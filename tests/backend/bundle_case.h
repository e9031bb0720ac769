#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <random>

#include "backend/bundle.h"

namespace corvid::test {

struct Case {
  BundleProblem truth;  ///< exact poses and points, noisy pixels
  BundleProblem start;  ///< disturbed
};

/// Poses on a gentle curve that look at a cloud of points, seen with noise.
inline Case make_case(const Camera& camera, int poses, int points, double noise_px,
                      std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> u(-1, 1);
  std::normal_distribution<double> normal;
  Case c;
  c.truth.camera = camera;
  for (int i = 0; i < poses; ++i) {
    c.truth.T_world_camera.emplace_back(so3_exp({0.05 * u(random), -0.03 * i, 0.05 * u(random)}),
                                        Eigen::Vector3d(0.4 * i, 0.1 * u(random), 0.1 * u(random)));
  }
  c.truth.fixed.assign(static_cast<std::size_t>(poses), 0);
  c.truth.fixed[0] = 1;
  c.truth.hold_distance = {{0, 1}};
  for (int j = 0; j < points; ++j) {
    c.truth.points.emplace_back(1 + 3 * u(random), 2 * u(random), 6 + 2 * u(random));
    for (int i = 0; i < poses; ++i) {
      const Pose& T = c.truth.T_world_camera[static_cast<std::size_t>(i)];
      const auto pixel = camera.project(T.inverse() * c.truth.points.back());
      if (!pixel || !camera.in_image(*pixel)) continue;
      c.truth.observations.push_back(
          {i, j, *pixel + noise_px * Eigen::Vector2d(normal(random), normal(random)),
           std::max(0.3, noise_px)});
    }
  }
  c.start = c.truth;
  // The second pose turns only, so that the held distance is the true one.
  for (std::size_t i = 1; i < c.start.T_world_camera.size(); ++i) {
    const Pose& T = c.truth.T_world_camera[i];
    const Eigen::Vector3d shift =
        i == 1 ? Eigen::Vector3d::Zero()
               : Eigen::Vector3d(0.03 * u(random), 0.03 * u(random), 0.03 * u(random));
    c.start.T_world_camera[i] =
        Pose(T.rotation() * so3_exp({0.01 * u(random), 0.01 * u(random), 0.01 * u(random)}),
             T.translation() + shift);
  }
  for (auto& p : c.start.points) p += 0.1 * Eigen::Vector3d(u(random), u(random), u(random));
  return c;
}

}  // namespace corvid::test
