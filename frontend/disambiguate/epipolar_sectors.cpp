#include "frontend/disambiguate/epipolar_sectors.h"

#include <Eigen/Dense>
#include <algorithm>
#include <utility>
#include <vector>

#include "frontend/epipolar.h"

namespace corvid {
namespace {

/// Which side of the epipole e of the target a match lies on, along its line: the sign of
/// (e x x_t) . (F x_r) is the same for all points in front of both cameras (Chum, Werner and Matas,
/// Epipolar geometry estimation via RANSAC benefits from the oriented epipolar constraint, 2004).
class Orientation {
 public:
  Orientation(const Eigen::Matrix3d& F, const MatchSets& sets)
      : epipole_(Eigen::JacobiSVD<Eigen::Matrix3d>(F, Eigen::ComputeFullU).matrixU().col(2)) {
    int positive = 0, negative = 0;
    for (const MatchSets::Point& point : sets.points) {
      if (!point.accepted) continue;
      const double s = side(F * point.x_r.homogeneous(), point.match());
      positive += s > 0;
      negative += s < 0;
    }
    if (positive > 9 * negative) sign_ = 1;
    if (negative > 9 * positive) sign_ = -1;
  }
  /// < 0: on the wrong side.
  [[nodiscard]] double operator()(const Eigen::Vector3d& line, const Eigen::Vector2d& x_t) const {
    return sign_ * side(line, x_t);
  }

 private:
  [[nodiscard]] double side(const Eigen::Vector3d& line, const Eigen::Vector2d& x_t) const {
    return epipole_.cross(Eigen::Vector3d(x_t.homogeneous())).dot(line);
  }
  Eigen::Vector3d epipole_;
  double sign_ = 0;  ///< 0: not known
};

}  // namespace

ModuleCounts reject_outside_sectors(MatchSets& sets, MatchedMesh& mesh, const Eigen::Matrix3d& F,
                                    double max_distance_px) {
  ModuleCounts counts;
  const Orientation orientation(F, sets);
  // A candidate on its point's own line, and on the right side, is in every sector of the point.
  const auto doubtful = [&](const Eigen::Vector2d& x_r, const Eigen::Vector2d& x_t) {
    return std::pair(sampson_distance_px(F, x_r, x_t) > max_distance_px,
                     orientation(F * x_r.homogeneous(), x_t) < 0);
  };
  std::vector<Eigen::Vector2d> places;
  std::vector<MatchSets::Point*> points;
  for (MatchSets::Point& point : sets.points) {
    if (!point.in_m()) continue;
    ++counts.in;
    if (std::none_of(point.x_t.begin(), point.x_t.end(), [&](const Eigen::Vector2d& x_t) {
          return doubtful(point.x_r, x_t) != std::pair(false, false);
        }))
      continue;
    places.push_back(point.x_r);
    points.push_back(&point);
  }
  const auto triangles = mesh.reference.triangles(places);
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!triangles[i]) continue;
    MatchSets::Point& point = *points[i];
    Eigen::Matrix3d lines;  // of the corners
    for (int k = 0; k < 3; ++k) {
      const std::size_t corner = mesh.points[(*triangles[i])[static_cast<std::size_t>(k)]];
      lines.col(k) = F * sets.points[corner].x_r.homogeneous();
    }
    for (std::size_t k = point.candidates.size(); k-- > 0;) {
      const Eigen::Vector2d x_t = point.x_t[k];
      const auto [off, back] = doubtful(point.x_r, x_t);
      // Between the lines of the corners are those places whose own epipolar line in the reference
      // crosses the triangle: corners on both sides of it.
      const Eigen::Vector3d sides = lines.transpose() * x_t.homogeneous();
      const bool outside = off && ((sides.array() > 0).all() || (sides.array() < 0).all());
      const bool behind = back && orientation(lines.col(0), x_t) < 0 &&
                          orientation(lines.col(1), x_t) < 0 && orientation(lines.col(2), x_t) < 0;
      if (!outside && !behind) continue;
      point.withdraw(k, Withdrawn::sectors);
      ++counts.rejected;
    }
  }
  return counts;
}

}  // namespace corvid
