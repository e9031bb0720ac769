#include "frontend/disambiguate/epipolar_constraint.h"

#include <limits>

#include "frontend/epipolar.h"

namespace corvid {

ModuleCounts reject_epipolar_outliers(MatchSets& sets, const Eigen::Matrix3d& F,
                                      double max_distance_px) {
  ModuleCounts counts;
  for (MatchSets::Point& point : sets.points) {
    if (!point.accepted) continue;
    ++counts.in;
    const std::size_t k = *point.accepted;
    if (sampson_distance_px(F, point.x_r, point.x_t[k]) <= max_distance_px) continue;
    point.candidates.erase(point.candidates.begin() + static_cast<std::ptrdiff_t>(k));
    point.x_t.erase(point.x_t.begin() + static_cast<std::ptrdiff_t>(k));
    point.accepted.reset();
    ++counts.rejected;
  }
  return counts;
}

ModuleCounts accept_epipolar(MatchSets& sets, const Eigen::Matrix3d& F, double ratio,
                             double max_distance_px) {
  ModuleCounts counts;
  for (MatchSets::Point& point : sets.points) {
    if (point.accepted || point.candidates.empty()) continue;
    ++counts.in;
    double d1 = std::numeric_limits<double>::max(), d2 = d1;
    std::size_t nearest = 0;
    for (std::size_t k = 0; k < point.candidates.size(); ++k) {
      const double d = sampson_distance_px(F, point.x_r, point.x_t[k]);
      if (d < d1) {
        d2 = d1;
        d1 = d;
        nearest = k;
      } else if (d < d2) {
        d2 = d;
      }
    }
    if (d1 >= max_distance_px) continue;
    if (point.candidates.size() > 1 && (d2 <= ratio * d1 || d2 <= max_distance_px)) continue;
    point.accepted = nearest;
    ++counts.accepted;
  }
  return counts;
}

}  // namespace corvid
