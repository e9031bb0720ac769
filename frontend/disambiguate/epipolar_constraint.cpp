#include "frontend/disambiguate/epipolar_constraint.h"

#include <vector>

#include "frontend/disambiguate/ratio_inequalities.h"
#include "frontend/epipolar.h"

namespace corvid {

ModuleCounts reject_epipolar_outliers(MatchSets& sets, const Eigen::Matrix3d& F,
                                      double max_distance_px) {
  ModuleCounts counts;
  for (MatchSets::Point& point : sets.points) {
    if (!point.accepted) continue;
    ++counts.in;
    if (sampson_distance_px(F, point.x_r, point.match()) <= max_distance_px) continue;
    point.withdraw(*point.accepted, Withdrawn::geometry);
    ++counts.rejected;
  }
  return counts;
}

ModuleCounts accept_epipolar(MatchSets& sets, const Eigen::Matrix3d& F, double ratio,
                             double max_distance_px) {
  ModuleCounts counts;
  std::vector<double> distances_px;
  for (MatchSets::Point& point : sets.points) {
    if (!point.in_m()) continue;
    ++counts.in;
    distances_px.clear();
    for (const Eigen::Vector2d& x_t : point.x_t)
      distances_px.push_back(sampson_distance_px(F, point.x_r, x_t));
    point.accepted = ratio_inequalities(distances_px, ratio, max_distance_px);
    counts.accepted += point.accepted.has_value();
  }
  return counts;
}

}  // namespace corvid
