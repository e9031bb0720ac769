#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>

#include "corvid/mesh_stream.h"

namespace corvid {

/// A closed sphere with outward normals, counter-clockwise faces and colours that vary over it.
inline TriangleMesh coloured_sphere(const Eigen::Vector3f& centre, float radius, int rings,
                                    int sectors) {
  TriangleMesh mesh;
  const auto add = [&](double polar, double azimuth) {
    const Eigen::Vector3f n(static_cast<float>(std::sin(polar) * std::cos(azimuth)),
                            static_cast<float>(std::sin(polar) * std::sin(azimuth)),
                            static_cast<float>(std::cos(polar)));
    mesh.vertices.push_back(centre + radius * n);
    mesh.normals.push_back(n);
    mesh.colours.push_back({static_cast<std::uint8_t>(127 + 127 * n.x()),
                            static_cast<std::uint8_t>(127 + 127 * n.y()),
                            static_cast<std::uint8_t>(127 + 127 * n.z())});
  };
  const double pi = std::acos(-1.0);
  add(0, 0);
  for (int r = 1; r < rings; ++r) {
    for (int s = 0; s < sectors; ++s) add(pi * r / rings, 2 * pi * s / sectors);
  }
  add(pi, 0);
  const auto at = [&](int r, int s) {
    return static_cast<std::uint32_t>(1 + (r - 1) * sectors + s % sectors);
  };
  const auto last = static_cast<std::uint32_t>(mesh.vertices.size() - 1);
  for (int s = 0; s < sectors; ++s) {
    mesh.triangles.push_back({0, at(1, s), at(1, s + 1)});
    for (int r = 1; r + 1 < rings; ++r) {
      mesh.triangles.push_back({at(r, s), at(r + 1, s), at(r + 1, s + 1)});
      mesh.triangles.push_back({at(r, s), at(r + 1, s + 1), at(r, s + 1)});
    }
    mesh.triangles.push_back({at(rings - 1, s), last, at(rings - 1, s + 1)});
  }
  return mesh;
}

/// Signed volume inside a closed mesh; positive if its faces are counter-clockwise from outside.
inline double signed_volume(const TriangleMesh& mesh) {
  double sum = 0;
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[t[0]].cast<double>();
    const Eigen::Vector3d b = mesh.vertices[t[1]].cast<double>();
    sum += a.dot(b.cross(mesh.vertices[t[2]].cast<double>())) / 6;
  }
  return sum;
}

}  // namespace corvid
