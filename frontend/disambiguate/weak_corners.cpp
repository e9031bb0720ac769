#include "frontend/disambiguate/weak_corners.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "core/median.h"

namespace corvid {

bool has_corner_score(const Eigen::Vector2f& point, int width_px, int height_px) {
  constexpr float kReachPx = 4;  // of corners.cl
  const auto inside = [](float x, int size) {
    return x > kReachPx - 0.5F && x < static_cast<float>(size) - kReachPx - 0.5F;
  };
  return inside(point.x(), width_px) && inside(point.y(), height_px);
}

bool is_weak_corner(float score_r, float score_t, const Eigen::Vector2f& point, int width_px,
                    int height_px, double ratio) {
  return has_corner_score(point, width_px, height_px) && score_r > ratio * score_t;
}

std::vector<std::vector<SearchCandidate>> take_weak_corners(
    CornerDetector& corners, const DeviceImage& reference, const DeviceImage& target, int level,
    std::span<const Eigen::Vector2d> points, double kappa, double ratio,
    std::vector<std::vector<SearchCandidate>>& candidates, Lane lane) {
  CORVID_CHECK(candidates.size() == points.size(), "one list of candidates per point");
  const double scale = std::ldexp(1.0, -level);
  std::vector<Eigen::Vector2f> x_r, x_t;
  for (std::size_t i = 0; i < points.size(); ++i) {
    x_r.emplace_back((points[i] * scale).cast<float>());
    for (const SearchCandidate& candidate : candidates[i])
      x_t.emplace_back((candidate.pixel * scale).cast<float>());
  }
  const auto score_r = corners.score_at(reference, x_r, kappa, lane);
  const auto score_t = corners.score_at(target, x_t, kappa, lane);
  std::vector<double> ratios;
  for (std::size_t i = 0, k = 0; i < points.size(); k += candidates[i++].size())
    if (!candidates[i].empty() && score_t[k].lambda_min > 0)
      ratios.push_back(score_r[i].lambda_min / score_t[k].lambda_min);
  const double typical = upper_median(std::move(ratios));
  const double exposure = typical > 0 ? typical : 1;

  std::vector<std::vector<SearchCandidate>> weak(points.size());
  std::size_t next = 0;
  for (std::size_t i = 0; i < points.size(); ++i)
    std::erase_if(candidates[i], [&](const SearchCandidate& candidate) {
      const std::size_t k = next++;
      const bool is_weak = is_weak_corner(score_r[i].lambda_min, score_t[k].lambda_min, x_t[k],
                                          target.width_px, target.height_px, exposure * ratio);
      if (is_weak) weak[i].push_back(candidate);
      return is_weak;
    });
  return weak;
}

}  // namespace corvid
