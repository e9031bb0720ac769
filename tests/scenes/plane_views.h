#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "corvid/camera.h"
#include "corvid/image.h"
#include "corvid/pose.h"

namespace corvid::testing {

/// Textured planes and spheres with exact depth. The texture is a function of the place in space,
/// so it fits on anything and looks the same from everywhere.
struct PlaneScene {
  struct Plane {
    Eigen::Vector3d normal;  ///< unit
    double offset = 0;       ///< normal . p = offset
  };
  struct Sphere {
    Eigen::Vector3d centre;
    double radius = 1;
  };
  std::vector<Plane> planes;
  std::vector<Sphere> spheres;
  double finest = 0.05;  ///< shortest wavelength of the texture [map units]
  double contrast = 45;  ///< standard deviation, about [grey levels]; 0: no texture
  std::uint32_t seed = 1;

  /// Distance along a unit ray to the nearest surface; infinite if there is none.
  [[nodiscard]] double cast(const Eigen::Vector3d& from, const Eigen::Vector3d& ray) const {
    double nearest = std::numeric_limits<double>::infinity();
    const auto hit = [&](double t) {
      if (t > 1e-9) nearest = std::min(nearest, t);
    };
    for (const Plane& p : planes) {
      const double slope = p.normal.dot(ray);
      if (slope != 0) hit((p.offset - p.normal.dot(from)) / slope);
    }
    for (const Sphere& s : spheres) {
      const Eigen::Vector3d c = from - s.centre;
      const double b = c.dot(ray), q = b * b - c.squaredNorm() + s.radius * s.radius;
      if (q >= 0) hit(-b - std::sqrt(q));
    }
    return nearest;
  }

  /// Smooth noise of four octaves, in [0, 255].
  [[nodiscard]] double texture(const Eigen::Vector3d& p) const {
    double sum = 0;
    for (int octave = 0; octave < 4; ++octave) {
      sum +=
          noise(p / (finest * (1 << octave)), static_cast<std::uint32_t>(octave)) * (octave + 1.0);
    }
    return std::clamp(128 + contrast * sum / 2, 0.0, 255.0);
  }

  /// 3x3 rays per pixel, rounded to whole grey levels.
  [[nodiscard]] GreyImage render(const Camera& camera, const Pose& T_world_camera) const {
    GreyImage out(camera.width_px, camera.height_px);
    for (int y = 0; y < out.height(); ++y) {
      for (int x = 0; x < out.width(); ++x) {
        double sum = 0;
        for (int i = 0; i < 9; ++i) {
          const Eigen::Vector2d pixel(x + (i % 3 - 1) / 3.0, y + (i / 3 - 1) / 3.0);
          const Eigen::Vector3d ray = T_world_camera.rotation() * camera.unproject(pixel).value();
          const double t = cast(T_world_camera.translation(), ray);
          sum += std::isfinite(t) ? texture(T_world_camera.translation() + t * ray) : 200;
        }
        out(x, y) = static_cast<std::uint8_t>(sum / 9 + 0.5);
      }
    }
    return out;
  }

  /// z at each pixel's centre; 0 where there is nothing.
  [[nodiscard]] FloatImage depth(const Camera& camera, const Pose& T_world_camera) const {
    FloatImage out(camera.width_px, camera.height_px);
    for (int y = 0; y < out.height(); ++y) {
      for (int x = 0; x < out.width(); ++x) {
        const Eigen::Vector3d ray = camera.unproject({x, y}).value();
        const double t = cast(T_world_camera.translation(), T_world_camera.rotation() * ray);
        if (std::isfinite(t)) out(x, y) = static_cast<float>(t * ray.z());
      }
    }
    return out;
  }

 private:
  /// Value noise in [-1, 1], tricubic between the lattice's random values.
  [[nodiscard]] double noise(const Eigen::Vector3d& p, std::uint32_t octave) const {
    const Eigen::Vector3d base = p.array().floor();
    const Eigen::Vector3d f = p - base;
    const Eigen::Vector3d s = f.array().square() * (3 - 2 * f.array());
    double sum = 0;
    for (int c = 0; c < 8; ++c) {
      double weight = 1;
      std::uint32_t h = seed * 0x9E3779B9U + octave * 0x85EBCA6BU;
      for (int axis = 0; axis < 3; ++axis) {
        const int high = c >> axis & 1;
        weight *= high ? s[axis] : 1 - s[axis];
        h ^= static_cast<std::uint32_t>(static_cast<int>(base[axis]) + high) + 0x7F4A7C15U;
        h *= 0xC2B2AE35U;
        h ^= h >> 15;
      }
      sum += weight * (h / 2147483647.5 - 1);
    }
    return sum;
  }
};

/// A pinhole without distortion; the principal point in the middle.
inline Camera pinhole(int width_px, int height_px, double focal_px) {
  Camera c;
  c.width_px = width_px;
  c.height_px = height_px;
  c.fx_px = c.fy_px = focal_px;
  c.cx_px = (width_px - 1) / 2.0;
  c.cy_px = (height_px - 1) / 2.0;
  return c;
}

}  // namespace corvid::testing
