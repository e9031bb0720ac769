#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace corvid {

/// One cell of the grid: corner c has the offset (c & 1, c >> 1 & 1, c >> 2 & 1).
struct CellEdge {
  std::uint8_t from = 0;  ///< corner at the lower end
  std::uint8_t axis = 0;  ///< 0, 1, 2: the other end is from | 1 << axis
};

/// The 12 edges of a cell.
[[nodiscard]] const std::array<CellEdge, 12>& cell_edges();

/// Triangles of a cell, as numbers of its edges, for a set of inside corners (bit c set: corner c
/// is inside). Counter-clockwise seen from outside.
///
/// Made by tracing: on each face of the cell, every run of inside corners is cut off by one
/// segment, which depends on that face alone; the segments chain into closed loops; a loop is cut
/// into triangles by diagonals that never lie in a face of the cell. So neighbouring cells meet
/// without cracks and no edge gets more than two faces.
[[nodiscard]] const std::vector<std::array<std::uint8_t, 3>>& cell_triangles(
    std::uint8_t inside_corners);

}  // namespace corvid
