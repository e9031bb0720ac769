#include "mapping/cut_mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "core/parallel_rows.h"
#include "mapping/marching_cubes.h"

namespace corvid {
namespace {

/// Distance to the surface [voxels], positive outside, with the signs of the labels.
class SignedField {
 public:
  SignedField(const CutLabels& labels, int smoothing, int threads) : l_(labels), threads_(threads) {
    value_.assign(l_.blocks.places(), kNothing);
    parallel_rows(static_cast<int>(l_.blocks.blocks()), 64, threads, [&](int first, int last) {
      for (int b = std::max(1, first); b < last; ++b) start_block(static_cast<std::uint32_t>(b));
    });
    smooth(smoothing);
  }

  /// Whether the voxel's distance was measured and fits its label. @pre the voxel is in the volume.
  [[nodiscard]] bool supported(const Eigen::Vector3i& voxel) const {
    const std::uint32_t place = l_.blocks.place(voxel);
    return place >= CrustBlocks::kNone && measured(place, l_.solid.test(voxel)).second > 0;
  }
  /// @pre the voxel is in the volume.
  [[nodiscard]] float operator()(const Eigen::Vector3i& voxel) const {
    const std::uint32_t place = l_.blocks.place(voxel);
    if (place >= CrustBlocks::kNone) return value_[place];
    return l_.solid.test(voxel) ? -1.F : 1.F;
  }

 private:
  static constexpr float kNothing = 100;  ///< outside of the volume
  static constexpr float kLeast = 0.05F;  ///< distance from the surface, at least

  /// What was measured, and how much it counts; nothing where the cut disagrees.
  [[nodiscard]] std::pair<float, float> measured(std::uint32_t place, bool solid) const {
    const std::uint8_t weight = l_.distances.weight[place];
    const std::int8_t d = l_.distances.distance[place];
    if (weight == 0 || (solid ? d >= 0 : d <= 0)) return {solid ? -0.5F : 0.5F, 0.F};
    return {static_cast<float>(d) / CutDistances::kSteps,
            static_cast<float>(weight) / CutDistances::kWeightSteps};
  }

  void start_block(std::uint32_t b) {
    const std::uint32_t low = b * CrustBlocks::kBlockVoxels;
    for (std::uint32_t place = low; place < low + CrustBlocks::kBlockVoxels; ++place) {
      const Eigen::Vector3i voxel = l_.blocks.voxel(place);
      if (!l_.solid.contains(voxel)) continue;
      const bool solid = l_.solid.test(voxel);
      const float d = measured(place, solid).first;
      value_[place] = solid ? std::min(d, -kLeast) : std::max(d, kLeast);
    }
  }

  /// The voxels next to the surface and those next to these.
  [[nodiscard]] std::vector<std::uint32_t> near_surface() const {
    std::vector<std::uint8_t> near(value_.size());
    const auto for_each = [&](auto&& call) {
      for (std::uint32_t p = CrustBlocks::kNone; p < value_.size(); ++p) {
        if (value_[p] == kNothing) continue;
        for (int d = 0; d < 6; ++d) {
          const std::uint32_t q = l_.blocks.neighbour(p, d);
          if (q >= CrustBlocks::kNone && value_[q] != kNothing) call(p, q);
        }
      }
    };
    for_each([&](std::uint32_t p, std::uint32_t q) {
      if ((value_[p] < 0) != (value_[q] < 0)) near[p] = 1;
    });
    for_each([&](std::uint32_t p, std::uint32_t q) {
      if (near[p] == 0 && near[q] == 1) near[p] = 2;
    });
    std::vector<std::uint32_t> out;
    for (std::uint32_t p = CrustBlocks::kNone; p < near.size(); ++p) {
      if (near[p] != 0) out.push_back(p);
    }
    return out;
  }

  void smooth(int passes) {
    const std::vector<std::uint32_t> active = near_surface();
    std::vector<float> smoothed(active.size());
    constexpr int kBand = 1 << 14;
    for (int pass = 0; pass < passes; ++pass) {
      parallel_rows(static_cast<int>(active.size()), kBand, threads_, [&](int first, int last) {
        for (int i = first; i < last; ++i) {
          const auto at = static_cast<std::size_t>(i);
          smoothed[at] = smoothed_value(active[at]);
        }
      });
      for (std::size_t i = 0; i < active.size(); ++i) value_[active[i]] = smoothed[i];
    }
  }

  [[nodiscard]] float smoothed_value(std::uint32_t place) const {
    const bool solid = value_[place] < 0;
    const auto [d, weight] = measured(place, solid);
    float sum = weight * d, weights = weight;
    for (int direction = 0; direction < 6; ++direction) {
      const std::uint32_t q = l_.blocks.neighbour(place, direction);
      if (q < CrustBlocks::kNone || value_[q] == kNothing) continue;
      sum += value_[q];
      weights += 1;
    }
    if (!(weights > 0)) return value_[place];
    return solid ? std::min(sum / weights, -kLeast) : std::max(sum / weights, kLeast);
  }

  const CutLabels& l_;
  int threads_;
  std::vector<float> value_;
};

/// Marching cubes, layer by layer.
class CutMesher {
 public:
  CutMesher(const CutLabels& labels, const SignedField& field, bool closed)
      : l_(labels), field_(field), closed_(closed), width_(labels.volume.size.x() + 1) {
    const auto cells =
        static_cast<std::size_t>(width_) * static_cast<std::size_t>(labels.volume.size.y() + 1);
    for (auto& layer : in_layer_) layer.assign(2 * cells, kNoVertex);
    between_.assign(cells, kNoVertex);
  }

  [[nodiscard]] TriangleMesh run(double min_island) {
    const Eigen::Vector3i& size = l_.volume.size;
    for (int z = -1; z < size.z(); ++z) {
      for (int y = -1; y < size.y(); ++y) {
        for (int i = -1; 64 * i < size.x(); ++i) add_cells(i, y, z);
      }
      in_layer_[0].swap(in_layer_[1]);
      std::fill(in_layer_[1].begin(), in_layer_[1].end(), kNoVertex);
      std::fill(between_.begin(), between_.end(), kNoVertex);
    }
    remove_islands(min_island);
    return std::move(mesh_);
  }

 private:
  enum class Support : std::uint8_t { none, measured, cap };
  static constexpr std::uint32_t kNoVertex = std::numeric_limits<std::uint32_t>::max();
  /// A crossing stays this far from the ends of its edge, so that float coordinates tell vertices
  /// apart and no face is without area.
  static constexpr float kMinFraction = 0.1F;

  /// The 64 cells from x = 64 * i on; of i = -1 only the last one.
  void add_cells(int i, int y, int z) {
    std::uint64_t any = 0, all = ~std::uint64_t{0};
    for (int row = 0; row < 4; ++row) {
      const std::uint64_t w = l_.solid.bits(i, y + (row & 1), z + (row >> 1));
      const std::uint64_t next = l_.solid.bits(i + 1, y + (row & 1), z + (row >> 1));
      const std::uint64_t shifted = w >> 1 | next << 63;
      any |= w | shifted;
      all &= w & shifted;
    }
    for (std::uint64_t mixed = any & ~all; mixed != 0; mixed &= mixed - 1) {
      add_cell({64 * i + std::countr_zero(mixed), y, z});
    }
  }

  static Eigen::Vector3i corner(const Eigen::Vector3i& cell, int c) {
    return cell + Eigen::Vector3i(c & 1, c >> 1 & 1, c >> 2 & 1);
  }

  void add_cell(const Eigen::Vector3i& cell) {
    unsigned inside = 0;
    bool in_volume = true;
    for (int c = 0; c < 8; ++c) {
      const Eigen::Vector3i p = corner(cell, c);
      if (!l_.solid.contains(p)) {
        in_volume = false;
        continue;
      }
      if (l_.solid.test(p)) inside |= 1U << c;
    }
    if (!closed_ && !(in_volume && any_supported(cell, inside))) return;
    for (const auto& triangle : cell_triangles(static_cast<std::uint8_t>(inside))) {
      std::array<std::uint32_t, 3> face{};
      for (std::size_t i = 0; i < 3; ++i) {
        const CellEdge edge = cell_edges()[triangle[i]];
        face[i] = vertex(corner(cell, edge.from), edge.axis, edge.from >> 2);
      }
      mesh_.triangles.push_back(face);
    }
  }

  /// Whether measurements support a crossing of the surface with an edge of the cell.
  [[nodiscard]] bool any_supported(const Eigen::Vector3i& cell, unsigned inside) const {
    return std::any_of(cell_edges().begin(), cell_edges().end(), [&](const CellEdge& edge) {
      const int to = edge.from | 1 << edge.axis;
      return (inside >> edge.from & 1U) != (inside >> to & 1U) &&
             field_.supported(corner(cell, edge.from)) && field_.supported(corner(cell, to));
    });
  }

  /// @param upper  1 if the edge starts in the upper layer of the cells.
  std::uint32_t vertex(const Eigen::Vector3i& p, int axis, int upper) {
    const std::size_t at = static_cast<std::size_t>(p.x() + 1) +
                           static_cast<std::size_t>(width_) * static_cast<std::size_t>(p.y() + 1);
    std::uint32_t& id =
        axis == 2
            ? between_[at]
            : in_layer_[static_cast<std::size_t>(upper)][2 * at + static_cast<std::size_t>(axis)];
    if (id != kNoVertex) return id;
    id = static_cast<std::uint32_t>(mesh_.vertices.size());
    const Eigen::Vector3i q = p + Eigen::Vector3i::Unit(axis);
    float t = 0.5F;  // caps lie on the outer faces of the volume
    if (l_.solid.contains(p) && l_.solid.contains(q)) {
      const float a = field_(p), b = field_(q);
      t = std::clamp(a / (a - b), kMinFraction, 1 - kMinFraction);
      support_.push_back(field_.supported(p) && field_.supported(q) ? Support::measured
                                                                    : Support::none);
    } else {
      support_.push_back(Support::cap);
    }
    Eigen::Vector3d position = p.cast<double>();
    position[axis] += t;
    mesh_.vertices.emplace_back((l_.volume.p_low + l_.volume.voxel_size * position).cast<float>());
    return id;
  }

  /// Leaves out the connected pieces that have too little support.
  void remove_islands(double min_island) {
    std::vector<std::uint32_t> root(mesh_.vertices.size());
    std::iota(root.begin(), root.end(), 0U);
    const auto find = [&](std::uint32_t v) {
      while (root[v] != v) v = root[v] = root[root[v]];
      return v;
    };
    for (const auto& f : mesh_.triangles) {
      for (std::size_t i = 1; i < 3; ++i) {
        const std::uint32_t a = find(f[0]), b = find(f[i]);
        root[std::max(a, b)] = std::min(a, b);
      }
    }
    std::vector<std::uint32_t> size(root.size()), support(root.size());
    for (std::uint32_t v = 0; v < root.size(); ++v) {
      size[find(v)] += support_[v] != Support::cap;
      support[find(v)] += support_[v] == Support::measured;
    }
    constexpr double kMinShare = 0.25;
    const std::uint32_t most =
        support.empty() ? 0 : *std::max_element(support.begin(), support.end());
    const auto kept = [&](std::uint32_t v) {
      const std::uint32_t r = find(v);
      return support[r] == most || (support[r] >= min_island * most &&
                                    support[r] >= kMinShare * size[r] && support[r] > 0);
    };
    std::vector<std::uint32_t> name(root.size());
    std::uint32_t n = 0;
    for (std::uint32_t v = 0; v < root.size(); ++v) {
      if (!kept(v)) continue;
      mesh_.vertices[n] = mesh_.vertices[v];
      name[v] = n++;
    }
    mesh_.vertices.resize(n);
    std::erase_if(mesh_.triangles, [&](const auto& f) { return !kept(f[0]); });
    for (auto& f : mesh_.triangles) {
      for (std::uint32_t& v : f) v = name[v];
    }
  }

  const CutLabels& l_;
  const SignedField& field_;
  bool closed_;
  int width_;
  std::array<std::vector<std::uint32_t>, 2> in_layer_;  ///< edges along x and y, lower and upper
  std::vector<std::uint32_t> between_;                  ///< edges along z
  TriangleMesh mesh_;
  std::vector<Support> support_;  ///< by vertex
};

void add_normals(TriangleMesh& mesh) {
  mesh.normals.assign(mesh.vertices.size(), Eigen::Vector3f::Zero());
  for (const auto& f : mesh.triangles) {
    const Eigen::Vector3f a = mesh.vertices[f[0]];
    const Eigen::Vector3f n = (mesh.vertices[f[1]] - a).cross(mesh.vertices[f[2]] - a);
    for (const std::uint32_t v : f) mesh.normals[v] += n;
  }
  for (Eigen::Vector3f& n : mesh.normals) {
    const float length = n.stableNorm();
    n = length > 0 ? Eigen::Vector3f(n / length) : Eigen::Vector3f::UnitZ();
  }
}

}  // namespace

TriangleMesh mesh_cut(const CutLabels& labels, int smoothing, double min_island, bool closed,
                      int threads) {
  const SignedField field(labels, smoothing, threads);
  TriangleMesh mesh = CutMesher(labels, field, closed).run(min_island);
  add_normals(mesh);
  return mesh;
}

void colour_cut(TriangleMesh& mesh, const CutVolume& volume, std::span<const CutView> views,
                std::span<const ColourImage* const> colours, int threads,
                const std::stop_token& stop) {
  mesh.colours.assign(mesh.vertices.size(), Rgb8{128, 128, 128});
  constexpr float kReach = 2.5F;         // of the depth around the vertex [voxels]
  constexpr float kLeastCosine = 0.15F;  // seen more slanted than that, a view is not asked
  const auto colour_one = [&](std::size_t i) {
    const Eigen::Vector3f q =
        ((mesh.vertices[i].cast<double>() - volume.p_low) / volume.voxel_size).cast<float>();
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    float weights = 0;
    for (std::size_t k = 0; k < views.size(); ++k) {
      if (!colours[k]) continue;
      const Eigen::Vector3f to_camera = views[k].centre().cast<float>() - q;
      const float cosine = to_camera.dot(mesh.normals[i]) / to_camera.norm();
      if (!(cosine > kLeastCosine)) continue;
      const Eigen::Vector3f p = views[k].origin() + views[k].axes() * q;
      const std::ptrdiff_t pixel = views[k].pixel(p);
      if (pixel < 0) continue;
      const float d = views[k].depth(pixel);
      if (!(d > 0) || std::abs(d - p.z()) > kReach * static_cast<float>(volume.voxel_size))
        continue;
      const Rgb8& c = colours[k]->data()[pixel];
      const float nearness = static_cast<float>(volume.voxel_size) / p.z();
      const float w = cosine * cosine * nearness * nearness *
                      std::clamp(views[k].confidence(pixel), 0.01F, 1.F);
      sum += w * Eigen::Vector3f(c.r, c.g, c.b);
      weights += w;
    }
    if (!(weights > 0)) return;
    const Eigen::Vector3f mean = (sum / weights).array() + 0.5F;
    const auto byte = [](float v) { return static_cast<std::uint8_t>(std::clamp(v, 0.F, 255.F)); };
    mesh.colours[i] = {byte(mean.x()), byte(mean.y()), byte(mean.z())};
  };
  constexpr std::size_t kBand = 4096;
  const auto bands = static_cast<int>((mesh.vertices.size() + kBand - 1) / kBand);
  parallel_rows(bands, 1, threads, [&](int first, int last) {
    if (stop.stop_requested()) return;
    const std::size_t end = std::min(mesh.vertices.size(), static_cast<std::size_t>(last) * kBand);
    for (std::size_t i = static_cast<std::size_t>(first) * kBand; i < end; ++i) colour_one(i);
  });
}

std::size_t unpaired_sides(const TriangleMesh& mesh) {
  std::vector<std::array<std::uint32_t, 2>> sides;
  sides.reserve(3 * mesh.triangles.size());
  for (const auto& f : mesh.triangles) {
    for (std::size_t i = 0; i < 3; ++i) sides.push_back({f[i], f[(i + 1) % 3]});
  }
  std::sort(sides.begin(), sides.end());
  std::size_t unpaired = 0;
  for (std::size_t i = 0; i < sides.size(); ++i) {
    const bool twice = i > 0 && sides[i] == sides[i - 1];
    const std::array<std::uint32_t, 2> back{sides[i][1], sides[i][0]};
    unpaired += twice || !std::binary_search(sides.begin(), sides.end(), back);
  }
  return unpaired;
}

}  // namespace corvid
