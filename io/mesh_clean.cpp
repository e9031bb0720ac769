#include "io/mesh_clean.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

namespace corvid {

std::array<std::int64_t, 3> QuantizationGrid::cell(const Eigen::Vector3f& p) const {
  std::array<std::int64_t, 3> out{};
  for (int i = 0; i < 3; ++i) {
    const double v = (static_cast<double>(p[i]) - origin[i]) / step();
    out[static_cast<std::size_t>(i)] = std::llround(std::clamp(v, -1e15, 1e15));
  }
  return out;
}

bool QuantizationGrid::encloses(const Eigen::Vector3f& p) const {
  if (!p.allFinite()) return false;
  const std::int64_t last = (std::int64_t{1} << bits) - 1;
  for (const std::int64_t k : cell(p)) {
    if (k < 0 || k > last) return false;
  }
  return true;
}

QuantizationGrid grid_around(const TriangleMesh& mesh, double max_step) {
  Eigen::Vector3f low = Eigen::Vector3f::Constant(std::numeric_limits<float>::max());
  Eigen::Vector3f high = -low;
  for (const Eigen::Vector3f& v : mesh.vertices) {
    if (!v.allFinite()) continue;
    low = low.cwiseMin(v);
    high = high.cwiseMax(v);
  }
  QuantizationGrid grid;
  if ((low.array() > high.array()).any()) return grid;
  grid.origin = low;
  // A hair wider than the mesh, so that rounding cannot put the last vertex outside.
  grid.range =
      std::max((high - low).maxCoeff() * 1.0001f, std::numeric_limits<float>::min() * 1e6f);
  if (max_step > 0) {
    grid.bits = 8;
    while (grid.bits < 20 && grid.step() > max_step) ++grid.bits;
  }
  return grid;
}

TriangleMesh clean_mesh(const TriangleMesh& mesh, const QuantizationGrid& grid) {
  using Triangle = std::array<std::uint32_t, 3>;
  const std::size_t n = mesh.vertices.size();
  std::vector<std::array<std::int64_t, 3>> cells(n);
  std::vector<bool> finite(n);
  for (std::size_t i = 0; i < n; ++i) {
    finite[i] = mesh.vertices[i].allFinite();
    if (finite[i]) cells[i] = grid.cell(mesh.vertices[i]);
  }
  std::vector<Triangle> kept, key;
  for (Triangle t : mesh.triangles) {
    if (std::max({t[0], t[1], t[2]}) >= n) continue;
    if (!finite[t[0]] || !finite[t[1]] || !finite[t[2]]) continue;
    if (cells[t[0]] == cells[t[1]] || cells[t[1]] == cells[t[2]] || cells[t[2]] == cells[t[0]]) {
      continue;
    }
    kept.push_back(t);
    std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
    key.push_back(t);
  }
  // Duplicates: the first of equal keys stays.
  std::vector<std::uint32_t> order(kept.size());
  std::iota(order.begin(), order.end(), 0u);
  std::stable_sort(order.begin(), order.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return key[a] < key[b]; });
  std::vector<bool> duplicate(kept.size());
  for (std::size_t i = 1; i < order.size(); ++i) {
    if (key[order[i]] == key[order[i - 1]]) duplicate[order[i]] = true;
  }

  const bool has_normals = n > 0 && mesh.normals.size() == n;
  const bool has_colours = n > 0 && mesh.colours.size() == n;
  std::vector<bool> used(n);
  for (std::size_t i = 0; i < kept.size(); ++i) {
    if (duplicate[i]) continue;
    for (const std::uint32_t v : kept[i]) used[v] = true;
  }
  TriangleMesh out;
  std::vector<std::uint32_t> renamed(n);
  for (std::size_t v = 0; v < n; ++v) {
    if (!used[v]) continue;
    renamed[v] = static_cast<std::uint32_t>(out.vertices.size());
    out.vertices.push_back(mesh.vertices[v]);
    if (has_colours) out.colours.push_back(mesh.colours[v]);
    if (has_normals) {
      const float length = mesh.normals[v].norm();
      // A normal that is not one points up in our world; writers need unit length.
      out.normals.push_back(std::isfinite(length) && length > 1e-12f
                                ? Eigen::Vector3f(mesh.normals[v] / length)
                                : Eigen::Vector3f(0, -1, 0));
    }
  }
  for (std::size_t i = 0; i < kept.size(); ++i) {
    if (duplicate[i]) continue;
    out.triangles.push_back({renamed[kept[i][0]], renamed[kept[i][1]], renamed[kept[i][2]]});
  }
  return out;
}

}  // namespace corvid
