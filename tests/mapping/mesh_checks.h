#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "corvid/mesh_stream.h"

namespace corvid::testing {

/// How the faces of a mesh hang together.
struct Topology {
  int open_edges = 0;        ///< with one face
  int crowded_edges = 0;     ///< with more than two faces
  int turned_edges = 0;      ///< whose two faces run along it in the same direction
  int split_vertices = 0;    ///< whose faces form more than one fan
  int degenerate_faces = 0;  ///< with two equal corners or without area
  [[nodiscard]] bool closed_manifold() const {
    return open_edges + crowded_edges + turned_edges + split_vertices + degenerate_faces == 0;
  }
};

inline Topology topology(const TriangleMesh& mesh) {
  Topology out;
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> directed, undirected;
  std::map<std::uint32_t, std::map<std::uint32_t, std::uint32_t>> fan;  // vertex: next of each rim
  std::map<std::uint32_t, int> faces_at;
  for (const auto& f : mesh.triangles) {
    const Eigen::Vector3f a = mesh.vertices[f[0]], b = mesh.vertices[f[1]], c = mesh.vertices[f[2]];
    if (!((b - a).cross(c - a).norm() > 0)) ++out.degenerate_faces;
    for (std::size_t i = 0; i < 3; ++i) {
      const auto p = f[i], q = f[(i + 1) % 3], r = f[(i + 2) % 3];
      ++directed[{p, q}];
      ++undirected[std::minmax(p, q)];
      fan[p][q] = r;
      ++faces_at[p];
    }
  }
  for (const auto& [edge, n] : undirected) {
    out.open_edges += n == 1;
    out.crowded_edges += n > 2;
  }
  for (const auto& [edge, n] : directed) out.turned_edges += n > 1;
  if (out.open_edges + out.crowded_edges + out.turned_edges == 0) {
    for (const auto& [vertex, next] : fan) {
      std::size_t steps = 0;
      std::uint32_t at = next.begin()->first;
      do {
        at = next.at(at);
        ++steps;
      } while (at != next.begin()->first && steps <= next.size());
      out.split_vertices += steps != next.size();
    }
  }
  return out;
}

/// Signed volume, positive if the faces look outward [map units^3].
inline double volume(const TriangleMesh& mesh) {
  double sum = 0;
  for (const auto& f : mesh.triangles) {
    sum += mesh.vertices[f[0]].cast<double>().dot(
               mesh.vertices[f[1]].cast<double>().cross(mesh.vertices[f[2]].cast<double>())) /
           6;
  }
  return sum;
}

}  // namespace corvid::testing
