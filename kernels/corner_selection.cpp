#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <unordered_map>
#include <utility>
#include <vector>

#include "core/check.h"
#include "kernels/corners.h"

namespace corvid {
namespace {

constexpr float kFar = 1e6F;  // cells of farther points would overflow

// Numbers cells of a size as they are met.
class Cells {
 public:
  Cells(double side, std::size_t expected) : side_(side) { ids_.reserve(expected); }

  std::size_t id(const Eigen::Vector2f& p) {
    const auto row = static_cast<std::int64_t>(std::floor(p.y() / side_));
    const auto column = static_cast<std::int64_t>(std::floor(p.x() / side_));
    return ids_.try_emplace((row << 32) + column, ids_.size()).first->second;
  }
  [[nodiscard]] std::size_t count() const { return ids_.size(); }

 private:
  double side_;
  std::unordered_map<std::int64_t, std::size_t> ids_;  // only asked, never listed
};

// Points that others must keep away from: lists in a grid over the area where others may be.
class Neighbourhood {
 public:
  Neighbourhood(double distance, const Eigen::AlignedBox2f& area) : distance_(distance) {
    if (!(distance > 0) || area.isEmpty()) return;
    constexpr double kMaxSide = 1024;  // cells; they may be larger than the distance
    origin_ = area.min().cast<double>();
    const Eigen::Vector2d size = area.sizes().cast<double>();
    cell_ = std::max({distance, size.maxCoeff() / kMaxSide, 1e-3});
    columns_ = static_cast<int>(size.x() / cell_) + 3;  // with a border of one cell
    rows_ = static_cast<int>(size.y() / cell_) + 3;
    newest_.assign(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_), -1);
  }

  void add(const Eigen::Vector2f& p) {
    const auto [column, row] = place(p);
    if (column < 0 || row < 0 || column >= columns_ || row >= rows_) return;  // near to nobody
    int& newest = newest_[index(column, row)];
    points_.push_back({p, newest});
    newest = static_cast<int>(points_.size()) - 1;
  }
  // p lies in the area.
  [[nodiscard]] bool near(const Eigen::Vector2f& p) const {
    if (newest_.empty()) return false;
    const auto [column, row] = place(p);
    for (int y = row - 1; y <= row + 1; ++y)
      for (int x = column - 1; x <= column + 1; ++x)
        for (int i = newest_[index(x, y)]; i >= 0; i = points_[static_cast<std::size_t>(i)].older)
          if ((p - points_[static_cast<std::size_t>(i)].p).cast<double>().squaredNorm() <
              distance_ * distance_)
            return true;
    return false;
  }

 private:
  struct Point {
    Eigen::Vector2f p;
    int older;  // in the same cell, -1: none
  };
  [[nodiscard]] std::pair<int, int> place(const Eigen::Vector2f& p) const {
    const Eigen::Vector2d at = (p.cast<double>() - origin_) / cell_;
    return {static_cast<int>(std::floor(at.x())) + 1, static_cast<int>(std::floor(at.y())) + 1};
  }
  [[nodiscard]] std::size_t index(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>(column);
  }

  double distance_, cell_ = 1;
  Eigen::Vector2d origin_ = Eigen::Vector2d::Zero();
  int columns_ = 0, rows_ = 0;
  std::vector<int> newest_;  // by cell, -1: none
  std::vector<Point> points_;
};

}  // namespace

std::vector<Corner> select_evenly(std::span<const Corner> corners, const CornerOptions& options) {
  CORVID_CHECK(options.cell_px > 0, "cells have a size");
  struct Waiting {
    const Corner* corner;
    Eigen::Vector2f p;
    std::size_t cell;
  };
  Cells cells(options.cell_px, corners.size());
  Eigen::AlignedBox2f area;
  std::vector<Waiting> waiting, next;
  waiting.reserve(corners.size());
  for (const Corner& corner : corners) {
    const Eigen::Vector2f p(corner.x_px, corner.y_px);
    CORVID_CHECK(p.cwiseAbs().maxCoeff() <= kFar, "corners lie in an image");
    area.extend(p);
    waiting.push_back({&corner, p, cells.id(p)});
  }
  Neighbourhood taken(options.min_distance_px, area);
  std::vector<int> in_cell(cells.count() + options.occupied.size());
  for (const Eigen::Vector2f& p : options.occupied) {
    if (!p.allFinite() || p.cwiseAbs().maxCoeff() > kFar) continue;
    taken.add(p);
    ++in_cell[cells.id(p)];
  }
  std::vector<Corner> selected;
  const auto full = [&] { return static_cast<int>(selected.size()) >= options.max_count; };
  // Round r fills cells up to r corners; what a full cell holds back waits for the next round.
  for (int round = 1; round <= options.max_per_cell && !waiting.empty() && !full(); ++round) {
    next.clear();
    for (const Waiting& candidate : waiting) {
      int& count = in_cell[candidate.cell];
      if (count >= round) {
        next.push_back(candidate);
        continue;
      }
      if (full()) break;
      if (taken.near(candidate.p)) continue;
      taken.add(candidate.p);
      ++count;
      selected.push_back(*candidate.corner);
    }
    std::swap(waiting, next);
  }
  return selected;
}

}  // namespace corvid
