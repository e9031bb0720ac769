#include "frontend/disambiguate/fundamental.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "frontend/disambiguate/epipolar_constraint.h"
#include "frontend/epipolar.h"

namespace corvid {

double chance_of_agreement(const MatchSets& sets, const Eigen::Matrix3d& F,
                           double max_distance_px) {
  Eigen::AlignedBox2d box;
  std::vector<double> beyond_px;  // distances of what does not nearly agree
  double candidates = 0;
  for (const MatchSets::Point& point : sets.points)
    for (const Eigen::Vector2d& x_t : point.x_t) {
      box.extend(x_t);
      ++candidates;
      const double d = sampson_distance_px(F, point.x_r, x_t) - 3 * max_distance_px;
      if (d > 0) beyond_px.push_back(d);
    }
  if (candidates == 0) return 1;
  // A band of half width sqrt(2) tau about a line through the box: Sampson distance tau.
  const double band_px2 = 2 * std::sqrt(2.0) * max_distance_px * box.diagonal().norm();
  double chance = band_px2 < box.volume() ? band_px2 / box.volume() : 1.0;
  if (!beyond_px.empty()) {
    const auto middle = beyond_px.begin() + static_cast<std::ptrdiff_t>(beyond_px.size() / 2);
    std::nth_element(beyond_px.begin(), middle, beyond_px.end());
    const double per_px = 0.5 * static_cast<double>(beyond_px.size()) / candidates / *middle;
    chance = std::max(chance, per_px * max_distance_px);
  }
  return std::min(chance, 1.0);
}

bool beyond_chance(int agreeing, int points, double chance) {
  constexpr int kSample = 8;
  if (agreeing <= kSample || agreeing > points || !(chance < 1)) return false;
  const auto log_choose = [](int n, int k) {
    return std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0);
  };
  const double log_chance = std::log(std::max(chance, std::numeric_limits<double>::min()));
  const double log_false_alarms = std::log(points) + log_choose(points, agreeing) +
                                  log_choose(agreeing, kSample) + (agreeing - kSample) * log_chance;
  return log_false_alarms < std::log(1e-6);
}

ModuleCounts fit_fundamental(MatchSets& sets, const DisambiguationOptions& options,
                             std::optional<Eigen::Matrix3d>& F) {
  ModuleCounts counts;
  std::vector<Eigen::Vector2d> x_r, x_t;
  for (const MatchSets::Point& point : sets.points)
    if (point.accepted) {
      x_r.push_back(point.x_r);
      x_t.push_back(point.match());
    }
  counts.in = static_cast<int>(x_r.size());
  const auto geometry = estimate_fundamental(x_r, x_t, options.max_epipolar_px, options.seed, F);
  F.reset();
  if (!geometry || geometry->inliers < options.min_matches ||
      !beyond_chance(geometry->inliers, counts.in,
                     chance_of_agreement(sets, geometry->F, options.max_epipolar_px)))
    return counts;
  F = geometry->F;
  counts.rejected = reject_epipolar_outliers(sets, *F, options.max_epipolar_px).rejected;
  return counts;
}

}  // namespace corvid
