#include "frontend/merge.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <unordered_map>

#include "core/check.h"

namespace corvid {

std::vector<std::size_t> find_duplicates(std::span<const Eigen::Vector2d> pixels,
                                         std::span<const Eigen::Vector2d> velocities_px,
                                         double distance_px) {
  CORVID_CHECK(velocities_px.empty() || velocities_px.size() == pixels.size(),
               "one velocity per point, or none");
  // Kept points by square cell: all within the distance lie in 3x3 cells.
  const auto key = [](std::int64_t x, std::int64_t y) { return (y << 32) + x; };
  const auto cell_of = [&](double v) {
    return static_cast<std::int64_t>(std::clamp(std::floor(v / distance_px), -1e9, 1e9));
  };
  std::unordered_map<std::int64_t, std::vector<std::size_t>> cells;
  std::vector<std::size_t> duplicates;
  const auto near = [&](std::size_t a, std::size_t b) {
    return (pixels[a] - pixels[b]).norm() < distance_px &&
           (velocities_px.empty() || (velocities_px[a] - velocities_px[b]).norm() < distance_px);
  };
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const std::int64_t x = cell_of(pixels[i].x()), y = cell_of(pixels[i].y());
    bool duplicate = false;
    for (std::int64_t dy = -1; dy <= 1 && !duplicate; ++dy)
      for (std::int64_t dx = -1; dx <= 1 && !duplicate; ++dx)
        if (const auto cell = cells.find(key(x + dx, y + dy)); cell != cells.end())
          for (const std::size_t k : cell->second) duplicate |= near(i, k);
    if (duplicate)
      duplicates.push_back(i);
    else
      cells[key(x, y)].push_back(i);
  }
  return duplicates;
}

}  // namespace corvid
