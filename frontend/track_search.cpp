#include "frontend/track_search.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace corvid {
namespace {

constexpr int kMaxRadiusPx = 16;

/// Half the side of the square that holds the warped template.
double warped_half_side(const Eigen::Matrix2d& warp, int template_px) {
  return 0.5 * (template_px - 1) * warp.cwiseAbs().rowwise().sum().maxCoeff() + 1;
}

bool fits(const DeviceImage& image, const Eigen::Vector2d& pixel, double border_px) {
  return pixel.x() >= border_px && pixel.y() >= border_px &&
         pixel.x() <= image.width_px - 1 - border_px &&
         pixel.y() <= image.height_px - 1 - border_px;
}

}  // namespace

Eigen::Matrix2d peak_covariance_px2(const NccPeak& peak) {
  constexpr double kLeastPx = 0.1, kMostPx = 4;
  const double cxx = peak.cxx, cxy = peak.cxy, cyy = peak.cyy;
  const double residual = 0.5 * std::max(1e-3, 1.0 - static_cast<double>(peak.score));
  const auto variance_px2 = [&](double curvature) {
    return std::clamp(residual / std::max(curvature, 1e-3), kLeastPx * kLeastPx, kMostPx * kMostPx);
  };
  // Eigenvalues of -H, the direction of the larger one.
  const double mean = -0.5 * (cxx + cyy), difference = std::hypot(0.5 * (cxx - cyy), cxy);
  const double angle = 0.5 * std::atan2(-2 * cxy, cyy - cxx);
  const Eigen::Vector2d strong(std::cos(angle), std::sin(angle)), weak(-strong.y(), strong.x());
  return variance_px2(mean + difference) * strong * strong.transpose() +
         variance_px2(mean - difference) * weak * weak.transpose();
}

SearchCandidate to_candidate(const NccPeak& peak, int level) {
  const double scale = std::ldexp(1.0, level);
  return {Eigen::Vector2d(peak.x_px, peak.y_px) * scale, peak.score,
          peak_covariance_px2(peak) * (scale * scale)};
}

std::vector<NccResult> TrackSearch::match_level(const DevicePyramid& target,
                                                std::span<const SearchQuery> queries,
                                                std::span<const LevelJob> jobs, int level,
                                                double peak_quality) {
  const double scale = std::ldexp(1.0, -level);
  // In one go, jobs of one anchor image after the other, in order of first appearance.
  std::vector<const DevicePyramid*> anchors;
  std::vector<std::vector<NccJob>> batch_jobs;
  std::vector<std::vector<std::size_t>> slots;
  for (std::size_t i = 0; i < jobs.size(); ++i) {
    const SearchQuery& query = queries[jobs[i].query];
    const auto known = std::find(anchors.begin(), anchors.end(), query.anchor.get());
    const auto a = static_cast<std::size_t>(known - anchors.begin());
    if (known == anchors.end()) {
      anchors.push_back(query.anchor.get());
      batch_jobs.emplace_back();
      slots.emplace_back();
    }
    NccJob job{};
    job.template_x_px = static_cast<float>(query.anchor_px.x() * scale);
    job.template_y_px = static_cast<float>(query.anchor_px.y() * scale);
    for (int k = 0; k < 4; ++k) job.warp[k] = static_cast<float>(query.warp(k / 2, k % 2));
    job.window_x_px = static_cast<std::int32_t>(std::lround(jobs[i].predicted_px.x() * scale));
    job.window_y_px = static_cast<std::int32_t>(std::lround(jobs[i].predicted_px.y() * scale));
    job.radius_x_px = job.radius_y_px = jobs[i].radius_px;
    batch_jobs[a].push_back(job);
    slots[a].push_back(i);
  }
  std::vector<NccBatch> batches;
  for (std::size_t a = 0; a < anchors.size(); ++a)
    batches.push_back({&anchors[a]->level(level), batch_jobs[a]});
  NccOptions options;
  options.template_px = template_px_;
  options.peak_quality = peak_quality;
  // Elsewhere the place is refined at the next level.
  if (level > 0) options.align_iterations = 0;
  const auto matched = matcher_.match(batches, target.level(level), options, Lane::tracking);
  std::vector<NccResult> results(jobs.size());
  std::size_t next = 0;
  for (const auto& of_anchor : slots)
    for (const std::size_t i : of_anchor) results[i] = matched[next++];
  return results;
}

std::vector<SearchCandidate> TrackSearch::track(const DevicePyramid& target,
                                                std::span<const SearchQuery> queries,
                                                const SearchSchedule& schedule) {
  const int first_level = std::min(schedule.first_level, target.levels() - 1);
  std::vector<SearchCandidate> found(queries.size());
  std::vector<Eigen::Vector2d> place(queries.size());
  std::vector<bool> begun(queries.size(), false);
  for (std::size_t i = 0; i < queries.size(); ++i) place[i] = queries[i].predicted_px;

  for (int level = first_level; level >= 0; --level) {
    const double scale = std::ldexp(1.0, -level);
    std::vector<LevelJob> jobs;
    for (std::size_t i = 0; i < queries.size(); ++i) {
      if (!place[i].allFinite()) continue;
      const double half = warped_half_side(queries[i].warp, template_px_);
      if (!fits(queries[i].anchor->level(level), queries[i].anchor_px * scale, half)) continue;
      if (!fits(target.level(level), place[i] * scale, 0.5 * template_px_)) continue;
      int radius = schedule.refine_radius_px;
      if (!begun[i]) {
        radius = std::min(schedule.first_radius_px << (first_level - level), kMaxRadiusPx);
      }
      jobs.push_back({i, place[i], radius});
    }
    const auto results = match_level(target, queries, jobs, level, 1.0);  // the best alone
    for (std::size_t j = 0; j < jobs.size(); ++j) {
      const std::size_t i = jobs[j].query;
      if (results[j].count == 0) continue;
      const SearchCandidate candidate = to_candidate(results[j].peaks[0], level);
      begun[i] = true;
      place[i] = candidate.pixel;
      if (level == 0) found[i] = candidate;
    }
  }
  return found;
}

std::vector<std::vector<SearchCandidate>> TrackSearch::candidates(
    const DevicePyramid& target, std::span<const SearchQuery> queries, int level, int radius_px) {
  std::vector<LevelJob> jobs;
  for (std::size_t i = 0; i < queries.size(); ++i)
    if (queries[i].predicted_px.allFinite())
      jobs.push_back({i, queries[i].predicted_px, radius_px});
  const auto results = match_level(target, queries, jobs, level, peak_quality_);
  std::vector<std::vector<SearchCandidate>> candidates(queries.size());
  for (std::size_t j = 0; j < jobs.size(); ++j)
    for (int k = 0; k < results[j].count; ++k)
      candidates[jobs[j].query].push_back(
          to_candidate(results[j].peaks[static_cast<std::size_t>(k)], level));
  return candidates;
}

}  // namespace corvid
