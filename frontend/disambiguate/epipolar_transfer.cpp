#include "frontend/disambiguate/epipolar_transfer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "core/check.h"
#include "frontend/disambiguate/correct_match.h"
#include "frontend/epipolar.h"

namespace corvid {
namespace {

constexpr double kHalfWindowPx = 15;  // of the 31 places along the line that are searched
constexpr double kLeastSine = 0.01;   // nearer to the trifocal plane, F itself is not good enough

std::optional<Eigen::Matrix3d> auxiliary_to_target(const MatchSets& sets,
                                                   const AuxiliaryView& auxiliary,
                                                   const DisambiguationOptions& options) {
  if (auxiliary.F_auxiliary_target) return auxiliary.F_auxiliary_target;
  std::vector<Eigen::Vector2d> x_t, x_a;
  for (std::size_t i = 0; i < sets.points.size(); ++i)
    if (sets.points[i].accepted && auxiliary.x_a[i]) {
      x_t.push_back(sets.points[i].match());
      x_a.push_back(*auxiliary.x_a[i]);
    }
  const auto geometry = estimate_fundamental(x_t, x_a, options.max_epipolar_px, options.seed);
  if (!geometry || geometry->inliers < options.min_matches) return std::nullopt;
  return geometry->F;
}

}  // namespace

std::optional<LineCrossing> cross_lines(const Eigen::Vector3d& first,
                                        const Eigen::Vector3d& second) {
  const Eigen::Vector3d a = first / first.head<2>().norm(), b = second / second.head<2>().norm();
  const Eigen::Vector3d crossing = a.cross(b);
  const double sine = std::abs(crossing.z());
  if (!crossing.allFinite() || sine < 1e-6) return std::nullopt;
  return LineCrossing{crossing.hnormalized(), {-a.y(), a.x()}, sine};
}

ModuleCounts accept_epipolar_transfer(MatchSets& sets, const Eigen::Matrix3d& F,
                                      const AuxiliaryView& auxiliary,
                                      const DisambiguationOptions& options) {
  CORVID_CHECK(auxiliary.x_a.size() == sets.points.size(), "one x_a per point");
  ModuleCounts counts;
  if (!auxiliary.support) return counts;
  const auto F_at = auxiliary_to_target(sets, auxiliary, options);
  if (!F_at) return counts;

  // Both lines are known to about tau_f across.
  const double least_sine =
      std::max(kLeastSine, std::sqrt(2.0) * options.max_epipolar_px / kHalfWindowPx);
  std::vector<AuxiliaryView::Probe> probes;
  std::vector<std::size_t> candidate_of;  // of each probe
  for (std::size_t i = 0; i < sets.points.size(); ++i) {
    const MatchSets::Point& point = sets.points[i];
    if (!point.in_m()) continue;
    ++counts.in;
    const std::size_t before = probes.size();
    for (std::size_t k = 0; k < point.x_t.size(); ++k) {
      if (sampson_distance_px(F, point.x_r, point.x_t[k]) > options.max_epipolar_px) continue;
      const auto [x_r, x_t] = correct_match(F, point.x_r, point.x_t[k]);
      const auto crossing = cross_lines(auxiliary.F_auxiliary_reference * x_r.homogeneous(),
                                        *F_at * x_t.homogeneous());
      if (!crossing || crossing->sine < least_sine) {
        // What cannot be looked up cannot be ruled out.
        probes.resize(before);
        candidate_of.resize(before);
        break;
      }
      probes.push_back({i, crossing->place, crossing->direction});
      candidate_of.push_back(k);
    }
  }
  if (probes.empty()) return counts;
  const std::vector<float> scores = auxiliary.support(probes);
  CORVID_CHECK(scores.size() == probes.size(), "one score per probe");

  for (std::size_t first = 0; first < probes.size();) {
    MatchSets::Point& point = sets.points[probes[first].point];
    std::size_t end = first;
    float best = 0;
    for (const SearchCandidate& candidate : point.candidates)
      best = std::max(best, candidate.score);
    for (; end < probes.size() && probes[end].point == probes[first].point; ++end)
      if (!std::isnan(scores[end])) best = std::max(best, scores[end]);
    bool all_seen = true;
    std::vector<std::size_t> supported;
    for (std::size_t k = first; k < end; ++k) {
      all_seen = all_seen && !std::isnan(scores[k]);
      if (scores[k] > 0 &&
          static_cast<double>(scores[k]) >= auxiliary.peak_quality * static_cast<double>(best))
        supported.push_back(candidate_of[k]);
    }
    if (all_seen && supported.size() == 1) {
      point.accepted = supported.front();
      ++counts.accepted;
    }
    first = end;
  }
  return counts;
}

}  // namespace corvid
