#include "mapping/depth_clean.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace corvid {
namespace {

void take_away(DepthMap& map, int x, int y) {
  map.depth(x, y) = 0;
  map.confidence(x, y) = 0;
}

/// In camera coordinates.
Eigen::Vector3d point_of(const DepthMap& map, int x, int y) {
  const double z = map.depth(x, y);
  return {(x - map.camera.cx_px) / map.camera.fx_px * z,
          (y - map.camera.cy_px) / map.camera.fy_px * z, z};
}

enum class Verdict { unknown, confirmed, contradicted };

Verdict ask(const DepthWitness& witness, const Eigen::Vector3d& p_camera, double tolerance) {
  const Eigen::Vector3d p = witness.T_witness_camera * p_camera;
  if (!(p.z() > 0)) return Verdict::unknown;
  const Camera& camera = witness.map->camera;
  const double u = camera.fx_px * p.x() / p.z() + camera.cx_px;
  const double v = camera.fy_px * p.y() / p.z() + camera.cy_px;
  const FloatImage& depth = witness.map->depth;
  if (!(u >= 0 && v >= 0 && u < depth.width() - 1 && v < depth.height() - 1)) {
    return Verdict::unknown;
  }
  // The four rays around: at an edge of something, one that fits is enough.
  bool seen_through = false;
  for (int i = 0; i < 4; ++i) {
    const double d = depth(static_cast<int>(u) + (i & 1), static_cast<int>(v) + (i >> 1));
    if (!(d > 0)) continue;
    if (std::abs(d - p.z()) <= tolerance * p.z()) return Verdict::confirmed;
    seen_through = seen_through || d > p.z();
    if (d < p.z()) return Verdict::unknown;
  }
  return seen_through ? Verdict::contradicted : Verdict::unknown;
}

}  // namespace

void weaken_ambiguous(DepthMap& map, const FloatImage& lead) {
  constexpr float kNoLead = 0.03F;
  constexpr float kClearLead = 0.15F;
  for (int y = 0; y < map.depth.height(); ++y) {
    for (int x = 0; x < map.depth.width(); ++x) {
      if (!(map.depth(x, y) > 0)) continue;
      if (lead(x, y) < kNoLead) {
        take_away(map, x, y);
      } else {
        map.confidence(x, y) *= 0.5F + 0.5F * std::min(1.0F, lead(x, y) / kClearLead);
      }
    }
  }
}

int remove_contradicted(DepthMap& map, std::span<const DepthWitness> witnesses, double tolerance,
                        const SliceEnd& slice_end) {
  if (witnesses.empty()) return 0;
  constexpr int kSliceRows = 16;
  Slicer rows(slice_end, kSliceRows);
  int removed = 0;
  for (int y = 0; y < map.depth.height(); ++y) {
    rows.piece();
    for (int x = 0; x < map.depth.width(); ++x) {
      if (!(map.depth(x, y) > 0)) continue;
      const Eigen::Vector3d p = point_of(map, x, y);
      bool contradicted = false, confirmed = false;
      for (const DepthWitness& witness : witnesses) {
        const Verdict verdict = ask(witness, p, tolerance);
        confirmed = confirmed || verdict == Verdict::confirmed;
        contradicted = contradicted || verdict == Verdict::contradicted;
      }
      if (confirmed || !contradicted) continue;
      take_away(map, x, y);
      ++removed;
    }
  }
  return removed;
}

Image<std::uint8_t> count_agreeing(const DepthMap& map, std::span<const DepthWitness> witnesses,
                                   double tolerance) {
  Image<std::uint8_t> count(map.depth.width(), map.depth.height());
  for (int y = 0; y < count.height(); ++y) {
    for (int x = 0; x < count.width(); ++x) {
      if (!(map.depth(x, y) > 0)) continue;
      const Eigen::Vector3d p = point_of(map, x, y);
      const auto agree = std::count_if(witnesses.begin(), witnesses.end(), [&](const auto& w) {
        return ask(w, p, tolerance) == Verdict::confirmed;
      });
      count(x, y) = static_cast<std::uint8_t>(std::min<std::ptrdiff_t>(1 + agree, 255));
    }
  }
  return count;
}

int remove_speckles(DepthMap& map, int min_rays, double max_jump) {
  const int width = map.depth.width(), height = map.depth.height();
  Image<std::uint8_t> visited(width, height);
  std::vector<std::pair<int, int>> island;
  int removed = 0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (visited(x, y) || !(map.depth(x, y) > 0)) continue;
      island.assign(1, {x, y});
      visited(x, y) = 1;
      for (std::size_t i = 0; i < island.size(); ++i) {
        const auto [px, py] = island[i];
        const double z = map.depth(px, py);
        constexpr std::array<std::array<int, 2>, 4> kSteps{{{1, 0}, {-1, 0}, {0, 1}, {0, -1}}};
        for (const auto& [dx, dy] : kSteps) {
          const int qx = px + dx, qy = py + dy;
          if (qx < 0 || qy < 0 || qx >= width || qy >= height || visited(qx, qy)) continue;
          const double other = map.depth(qx, qy);
          if (!(other > 0) || std::abs(other - z) > max_jump * std::min(z, other)) continue;
          visited(qx, qy) = 1;
          island.emplace_back(qx, qy);
        }
      }
      if (static_cast<int>(island.size()) >= min_rays) continue;
      for (const auto& [px, py] : island) take_away(map, px, py);
      removed += static_cast<int>(island.size());
    }
  }
  return removed;
}

}  // namespace corvid
