#pragma once

#include <Eigen/Core>
#include <array>

#include "corvid/camera.h"

/// The lens models behind Camera, on normalised image coordinates: pixel = (fx x + cx, fy y + cy).
/// docs/conventions.md has the equations.
namespace corvid::lens {

using Distortion = std::array<double, 5>;

struct Projection {
  Eigen::Vector2d xy;
  Eigen::Matrix<double, 2, 3> d_point;
  Eigen::Matrix<double, 2, 5> d_distortion;  ///< filled only on request
};

struct Ray {
  Eigen::Vector3d direction;         ///< unit
  Eigen::Matrix<double, 3, 2> d_xy;  ///< by the normalised image coordinates
};

/// Whether c[0] + c[1] x + ... + c[N-1] x^(N-1) is positive on all of [0, end]; c[0] > 0.
/// By the signs of the Bernstein coefficients on [0, end], halving the interval where they do not
/// decide (Farouki, "The Bernstein polynomial basis: a centennial retrospective", 2012, 3). For
/// the lenses of this world the first look nearly always decides, at about 10 multiplications:
/// cheap enough for every projection, so that no limit has to be kept beside the camera.
/// A minimum within about 1e-6 of zero counts as not positive.
[[nodiscard]] bool positive_up_to(std::array<double, 4> c, double end);
[[nodiscard]] bool positive_up_to(std::array<double, 5> c, double end);

/// False where the model does not hold: then `out` is undefined.
[[nodiscard]] bool project(CameraModel model, const Distortion& k, const Eigen::Vector3d& p,
                           bool with_distortion_jacobian, Projection& out);
/// False where no ray of the model's domain meets `xy`.
[[nodiscard]] bool unproject(CameraModel model, const Distortion& k, const Eigen::Vector2d& xy,
                             Ray& out);

}  // namespace corvid::lens
