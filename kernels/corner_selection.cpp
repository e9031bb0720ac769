#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "core/check.h"
#include "kernels/corners.h"

namespace corvid {
namespace {

using Cell = std::pair<int, int>;

Cell cell_of(const Eigen::Vector2f& p, double side) {
  return {static_cast<int>(std::floor(p.y() / side)), static_cast<int>(std::floor(p.x() / side))};
}

// Points that others must keep away from, in cells as wide as the distance to keep.
class Neighbourhood {
 public:
  explicit Neighbourhood(double distance) : distance_(distance) {}

  void add(const Eigen::Vector2f& p) {
    if (distance_ > 0) cells_[cell_of(p, distance_)].push_back(p);
  }
  [[nodiscard]] bool near(const Eigen::Vector2f& p) const {
    if (!(distance_ > 0)) return false;
    const auto [row, column] = cell_of(p, distance_);
    for (int y = row - 1; y <= row + 1; ++y)
      for (int x = column - 1; x <= column + 1; ++x)
        if (const auto found = cells_.find({y, x}); found != cells_.end())
          for (const Eigen::Vector2f& q : found->second)
            if ((p - q).cast<double>().squaredNorm() < distance_ * distance_) return true;
    return false;
  }

 private:
  double distance_;
  std::map<Cell, std::vector<Eigen::Vector2f>> cells_;
};

}  // namespace

std::vector<Corner> select_evenly(std::span<const Corner> corners, const CornerOptions& options) {
  CORVID_CHECK(options.cell_px > 0, "cells have a size");
  constexpr float kFar = 1e6F;  // cells of farther points would overflow
  Neighbourhood taken(options.min_distance_px);
  std::map<Cell, int> in_cell;
  for (const Eigen::Vector2f& p : options.occupied) {
    if (!p.allFinite() || p.cwiseAbs().maxCoeff() > kFar) continue;
    taken.add(p);
    ++in_cell[cell_of(p, options.cell_px)];
  }
  std::vector<Corner> selected;
  std::vector<const Corner*> waiting;
  for (const Corner& corner : corners) waiting.push_back(&corner);
  const auto full = [&] { return static_cast<int>(selected.size()) >= options.max_count; };
  // Round r fills cells up to r corners; what a full cell holds back waits for the next round.
  for (int round = 1; round <= options.max_per_cell && !waiting.empty() && !full(); ++round) {
    std::vector<const Corner*> next;
    for (const Corner* corner : waiting) {
      const Eigen::Vector2f p(corner->x_px, corner->y_px);
      int& count = in_cell[cell_of(p, options.cell_px)];
      if (count >= round) {
        next.push_back(corner);
        continue;
      }
      if (full()) break;
      if (taken.near(p)) continue;
      taken.add(p);
      ++count;
      selected.push_back(*corner);
    }
    waiting = std::move(next);
  }
  return selected;
}

}  // namespace corvid
