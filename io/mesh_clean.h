#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "corvid/mesh_stream.h"

namespace corvid {

/// The lattice on which positions are stored: origin + k * step, k in [0, 2^bits - 1] per axis.
/// Meshes that share a lattice share their seams exactly.
struct QuantizationGrid {
  Eigen::Vector3f origin = Eigen::Vector3f::Zero();  ///< [map units]
  float range = 1;                                   ///< edge of the cube [map units]
  int bits = 14;                                     ///< 1 to 30

  [[nodiscard]] double step() const { return range / static_cast<double>((1u << bits) - 1u); }
  /// Lattice point of a position; outside [0, 2^bits - 1] if the position is outside the cube.
  [[nodiscard]] std::array<std::int64_t, 3> cell(const Eigen::Vector3f& p) const;
  [[nodiscard]] bool encloses(const Eigen::Vector3f& p) const;
};

/// The cube around a mesh's finite vertices, with the fewest bits (at least 8, at most 20) whose
/// step is not above `max_step` [map units]; `max_step` 0: 14 bits.
[[nodiscard]] QuantizationGrid grid_around(const TriangleMesh& mesh, double max_step = 0);

/// What a writer may rely on: every index valid, every vertex finite and used by a triangle, no
/// triangle with two corners on the same lattice point, none twice with the same corners in the
/// same order, normals of unit length, and normals and colours one per vertex or none.
/// Order is kept. O(n log n).
[[nodiscard]] TriangleMesh clean_mesh(const TriangleMesh& mesh, const QuantizationGrid& grid);

}  // namespace corvid
