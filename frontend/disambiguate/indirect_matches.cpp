#include "frontend/disambiguate/indirect_matches.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "core/check.h"
#include "frontend/disambiguate/ratio_inequalities.h"

namespace corvid {
namespace {

/// Points by the cell of a grid that they lie in.
class Grid {
 public:
  Grid(std::span<const Eigen::Vector2d> points, double cell_px) : cell_px_(cell_px) {
    for (std::size_t i = 0; i < points.size(); ++i)
      if (const auto cell = cell_of(points[i])) entries_.emplace_back(*cell, i);
    std::sort(entries_.begin(), entries_.end());
  }
  /// Calls function(i) for every point within a cell's side of `place`, and some beyond.
  template <typename Function>
  void near(const Eigen::Vector2d& place, const Function& function) const {
    const auto cell = cell_of(place);
    if (!cell) return;
    for (std::int64_t row = cell->first - 1; row <= cell->first + 1; ++row) {
      auto entry = std::lower_bound(entries_.begin(), entries_.end(),
                                    std::pair(std::pair(row, cell->second - 1), std::size_t{0}));
      for (; entry != entries_.end() && entry->first <= std::pair(row, cell->second + 1); ++entry)
        function(entry->second);
    }
  }

 private:
  using Cell = std::pair<std::int64_t, std::int64_t>;  ///< row, column
  /// Nothing for places that are not finite, or too far away to be in an image.
  [[nodiscard]] std::optional<Cell> cell_of(const Eigen::Vector2d& place) const {
    if (!place.allFinite() || place.cwiseAbs().maxCoeff() > 1e12 * cell_px_) return std::nullopt;
    return Cell{static_cast<std::int64_t>(std::floor(place.y() / cell_px_)),
                static_cast<std::int64_t>(std::floor(place.x() / cell_px_))};
  }
  double cell_px_;
  std::vector<std::pair<Cell, std::size_t>> entries_;
};

}  // namespace

std::vector<std::optional<Eigen::Vector2d>> indirect_matches(
    std::span<const std::optional<Eigen::Vector2d>> x_2, std::span<const Eigen::Vector2d> x_2_hat,
    std::span<const Eigen::Vector2d> x_3, double ratio, double global_px) {
  CORVID_CHECK(x_2_hat.size() == x_3.size(), "one x_3 per x^_2");
  std::vector<std::optional<Eigen::Vector2d>> found(x_2.size());
  if (!(global_px > 0)) return found;
  // What is farther than this decides nothing: the nearest is within global_px.
  const Grid grid(x_2_hat, global_px * std::max(1.0, ratio));
  std::vector<double> distances_px;
  std::vector<std::size_t> near;
  for (std::size_t i = 0; i < x_2.size(); ++i) {
    if (!x_2[i]) continue;
    distances_px.clear();
    near.clear();
    grid.near(*x_2[i], [&](std::size_t k) {
      near.push_back(k);
      distances_px.push_back((x_2_hat[k] - *x_2[i]).norm());
    });
    if (const auto best = ratio_inequalities(distances_px, ratio, global_px))
      found[i] = x_3[near[*best]];
  }
  return found;
}

}  // namespace corvid
