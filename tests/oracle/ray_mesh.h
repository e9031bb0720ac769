#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <limits>

#include "corvid/mesh_stream.h"

namespace corvid::oracle {

struct MeshHit {
  double t = std::numeric_limits<double>::infinity();  ///< infinity: none
  std::size_t triangle = 0;
};
/// The least t > 0 at which origin + t * ray meets a triangle of the mesh:
/// Moller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997, over all of them.
[[nodiscard]] inline MeshHit first_hit(const TriangleMesh& mesh, const Eigen::Vector3d& origin,
                                       const Eigen::Vector3d& ray) {
  constexpr double kSlack = 1e-7;  // a ray through a shared edge meets at least one side of it
  MeshHit best;
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
    const auto& triangle = mesh.triangles[i];
    const Eigen::Vector3d a = mesh.vertices[triangle[0]].cast<double>();
    const Eigen::Vector3d ab = mesh.vertices[triangle[1]].cast<double>() - a;
    const Eigen::Vector3d ac = mesh.vertices[triangle[2]].cast<double>() - a;
    const Eigen::Vector3d p = ray.cross(ac);
    const double determinant = ab.dot(p);
    if (determinant == 0) continue;
    const Eigen::Vector3d s = origin - a;
    const double u = s.dot(p) / determinant;
    if (u < -kSlack || u > 1 + kSlack) continue;
    const Eigen::Vector3d q = s.cross(ab);
    const double v = ray.dot(q) / determinant;
    if (v < -kSlack || u + v > 1 + kSlack) continue;
    const double t = ac.dot(q) / determinant;
    if (t > 0 && t < best.t) best = {t, i};
  }
  return best;
}

}  // namespace corvid::oracle
