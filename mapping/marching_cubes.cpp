#include "mapping/marching_cubes.h"

#include <optional>
#include <span>

#include "core/check.h"

namespace corvid {
namespace {

using Triangles = std::vector<std::array<std::uint8_t, 3>>;

std::uint8_t edge_between(int a, int b) {
  const int low = a & b;
  const int axis = (a ^ b) == 1 ? 0 : (a ^ b) == 2 ? 1 : 2;
  for (std::uint8_t e = 0; e < 12; ++e) {
    if (cell_edges()[e].from == low && cell_edges()[e].axis == axis) return e;
  }
  check_failed(__FILE__, __LINE__, "edge", "corners are not neighbours");
}

/// The 6 faces as cycles of corners, counter-clockwise seen from outside the cell.
std::array<std::array<int, 4>, 6> make_faces() {
  std::array<std::array<int, 4>, 6> faces{};
  for (int axis = 0; axis < 3; ++axis) {
    const int u = 1 << (axis + 1) % 3, v = 1 << (axis + 2) % 3, high = 1 << axis;
    faces[static_cast<std::size_t>(2 * axis)] = {0, v, u | v, u};
    faces[static_cast<std::size_t>(2 * axis + 1)] = {high, high | u, high | u | v, high | v};
  }
  return faces;
}

/// Two edges share a face if both have an end fixed on the same side of the same axis.
bool in_one_face(std::uint8_t a, std::uint8_t b) {
  const CellEdge ea = cell_edges()[a], eb = cell_edges()[b];
  for (int axis = 0; axis < 3; ++axis) {
    if (ea.axis == axis || eb.axis == axis) continue;
    if ((ea.from >> axis & 1) == (eb.from >> axis & 1)) return true;
  }
  return false;
}

/// Cuts the polygon loop[first..last] into triangles without a diagonal in a face of the cell.
std::optional<Triangles> triangulate(std::span<const std::uint8_t> loop) {
  const std::size_t last = loop.size() - 1;
  if (last == 1) return Triangles{};
  for (std::size_t k = 1; k < last; ++k) {
    if (k > 1 && in_one_face(loop[0], loop[k])) continue;
    if (k + 1 < last && in_one_face(loop[k], loop[last])) continue;
    const auto before = triangulate(loop.subspan(0, k + 1));
    const auto after = triangulate(loop.subspan(k));
    if (!before || !after) continue;
    Triangles out = *before;
    out.push_back({loop[0], loop[k], loop[last]});
    out.insert(out.end(), after->begin(), after->end());
    return out;
  }
  return std::nullopt;
}

Triangles make_triangles(unsigned inside) {
  constexpr std::uint8_t kNone = 255;
  std::array<std::uint8_t, 12> next;
  next.fill(kNone);
  const auto is_inside = [&](int corner) { return (inside >> corner & 1U) != 0; };
  for (const auto& face : make_faces()) {
    const auto corner = [&](std::size_t i) { return face[i % 4]; };
    for (std::size_t start = 0; start < 4; ++start) {
      if (!is_inside(corner(start)) || is_inside(corner(start + 3))) continue;
      std::size_t end = start;
      while (is_inside(corner(end + 1))) ++end;
      next[edge_between(corner(start + 3), corner(start))] =
          edge_between(corner(end), corner(end + 1));
    }
  }
  Triangles out;
  std::array<bool, 12> done{};
  for (std::uint8_t e = 0; e < 12; ++e) {
    if (next[e] == kNone || done[e]) continue;
    std::vector<std::uint8_t> loop;
    for (std::uint8_t k = e; !done[k]; k = next[k]) {
      done[k] = true;
      loop.push_back(k);
    }
    const auto triangles = triangulate(loop);
    CORVID_CHECK(triangles, "every contour loop of a cell can be triangulated");
    out.insert(out.end(), triangles->begin(), triangles->end());
  }
  return out;
}

}  // namespace

const std::array<CellEdge, 12>& cell_edges() {
  static const std::array<CellEdge, 12> edges = [] {
    std::array<CellEdge, 12> out{};
    std::size_t n = 0;
    for (std::uint8_t corner = 0; corner < 8; ++corner) {
      for (std::uint8_t axis = 0; axis < 3; ++axis) {
        if ((corner >> axis & 1) == 0) out[n++] = {corner, axis};
      }
    }
    return out;
  }();
  return edges;
}

const std::vector<std::array<std::uint8_t, 3>>& cell_triangles(std::uint8_t inside_corners) {
  static const std::array<Triangles, 256> table = [] {
    std::array<Triangles, 256> out;
    for (unsigned i = 0; i < 256; ++i) out[i] = make_triangles(i);
    return out;
  }();
  return table[inside_corners];
}

}  // namespace corvid
