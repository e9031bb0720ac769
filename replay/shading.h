#pragma once

#include <Eigen/Core>

#include "replay/town.h"

namespace corvid {

/// A place on a surface as a pixel sees it.
struct SurfaceHit {
  Eigen::Vector3d point;
  Eigen::Vector3d normal;  ///< unit, of the face or the ground's triangle
  Eigen::Vector3d dx, dy;  ///< movement on the surface per pixel in the image's x and y [m]
};

/// Linear radiance (red, green, blue; about 0 to 1), the same from every side: all surfaces are
/// Lambertian, so that a surface point looks the same in every frame. Patterns are functions of
/// the surface point, integrated over the pixel's footprint.
[[nodiscard]] Eigen::Vector3f shade_ground(const Town& town, const SurfaceHit& hit);
[[nodiscard]] Eigen::Vector3f shade_face(const Town& town, const Solid& solid, const Face& face,
                                         const SurfaceHit& hit);
[[nodiscard]] Eigen::Vector3f shade_sky(const Town& town, const Eigen::Vector3d& ray);

}  // namespace corvid
