#include "frontend/align.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace corvid {
namespace {

constexpr int kTemplatePx = 21;
constexpr int kCoarseSidePx = 130;  // widest side of the level that is searched
constexpr double kTolerancePx = 4;  // agreement of two matches at that level
constexpr double kMinScore = 0.45;
constexpr int kMinVotes = 5;

struct Vote {
  Eigen::Vector2d reference, target;
  double score = 0;
};

struct Hypothesis {
  double angle_rad = 0, scale = 1;
  double weight = 0;
  std::vector<Vote> votes;
};

Eigen::Matrix2d rotation(double angle_rad) {
  return Eigen::Rotation2Dd(angle_rad).toRotationMatrix();
}

/// Template centres on a regular grid of the reference, where a turned template fits.
std::vector<Eigen::Vector2d> grid(const DeviceImage& image) {
  const double margin = 0.5 * kTemplatePx * std::numbers::sqrt2 + 1;
  std::vector<Eigen::Vector2d> centres;
  const int columns = 8, rows = 6;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < columns; ++c)
      centres.emplace_back(margin + (image.width_px - 1 - 2 * margin) * c / (columns - 1),
                           margin + (image.height_px - 1 - 2 * margin) * r / (rows - 1));
  return centres;
}

/// Searches all templates, turned and scaled, and keeps the largest set that agrees on a
/// translation.
Hypothesis test(NccMatcher& matcher, const DeviceImage& reference, const DeviceImage& target,
                const std::vector<Eigen::Vector2d>& centres, double angle_rad, double scale,
                Lane lane) {
  const Eigen::Matrix2d forward = scale * rotation(angle_rad);
  const Eigen::Matrix2d warp = forward.inverse();  // target offset -> reference offset
  std::vector<NccJob> jobs;
  for (const Eigen::Vector2d& centre : centres) {
    NccJob job{};
    job.template_x_px = static_cast<float>(centre.x());
    job.template_y_px = static_cast<float>(centre.y());
    for (int k = 0; k < 4; ++k) job.warp[k] = static_cast<float>(warp(k / 2, k % 2));
    job.window_x_px = target.width_px / 2;
    job.window_y_px = target.height_px / 2;
    job.radius_x_px = target.width_px / 2;
    job.radius_y_px = target.height_px / 2;
    jobs.push_back(job);
  }
  NccOptions options;
  options.template_px = kTemplatePx;
  options.peak_quality = 0.8;
  const auto results = matcher.match(reference, target, jobs, options, lane);
  std::vector<Vote> votes;
  for (std::size_t i = 0; i < results.size(); ++i)
    for (int k = 0; k < results[i].count; ++k) {
      const NccPeak& peak = results[i].peaks[static_cast<std::size_t>(k)];
      if (peak.score >= kMinScore)
        votes.push_back({centres[i], Eigen::Vector2d(peak.x_px, peak.y_px), peak.score});
    }
  Hypothesis best{angle_rad, scale, 0, {}};
  for (const Vote& centre : votes) {
    const Eigen::Vector2d t = centre.target - forward * centre.reference;
    Hypothesis candidate{angle_rad, scale, 0, {}};
    const Eigen::Vector2d* last = nullptr;
    for (const Vote& vote : votes) {
      if ((vote.target - forward * vote.reference - t).norm() > kTolerancePx) continue;
      if (last && *last == vote.reference) continue;  // one vote for each template
      last = &vote.reference;
      candidate.votes.push_back(vote);
      candidate.weight += vote.score * vote.score;
    }
    if (candidate.weight > best.weight) best = std::move(candidate);
  }
  return best;
}

double angle_between(double a, double b) {
  return std::abs(std::remainder(a - b, 2 * std::numbers::pi));
}

}  // namespace

Eigen::Matrix2d ImageSimilarity::linear() const { return scale * rotation(angle_rad); }

ImageSimilarity align_images(NccMatcher& matcher, const DevicePyramid& reference,
                             const DevicePyramid& target, Lane lane) {
  ImageSimilarity result;
  int level = 0;
  while (level + 1 < std::min(reference.levels(), target.levels()) &&
         std::max(reference.level(level).width_px, reference.level(level).height_px) >
             kCoarseSidePx)
    ++level;
  const DeviceImage& r = reference.level(level);
  const DeviceImage& t = target.level(level);
  if (std::min({r.width_px, r.height_px, t.width_px, t.height_px}) < 2 * kTemplatePx) return result;
  const auto centres = grid(r);

  constexpr double kStep = std::numbers::pi / 12;
  std::vector<Hypothesis> turns;
  for (int k = 0; k < 24; ++k) turns.push_back(test(matcher, r, t, centres, k * kStep, 1.0, lane));
  std::sort(turns.begin(), turns.end(),
            [](const Hypothesis& a, const Hypothesis& b) { return a.weight > b.weight; });
  // Finer angles and other scales around the three best turns.
  Hypothesis best = turns[0];
  for (int k = 0; k < 3; ++k)
    for (double angle : {-0.4, 0.0, 0.4})
      for (double scale : {0.8, 0.9, 1.0, 1.12, 1.25}) {
        if (angle == 0 && scale == 1.0) continue;
        Hypothesis h =
            test(matcher, r, t, centres,
                 turns[static_cast<std::size_t>(k)].angle_rad + angle * kStep, scale, lane);
        if (h.weight > best.weight) best = std::move(h);
      }
  double rival = 0;
  for (const Hypothesis& turn : turns)
    if (angle_between(turn.angle_rad, best.angle_rad) > 2.5 * kStep)
      rival = std::max(rival, turn.weight);
  result.votes = static_cast<int>(best.votes.size());
  if (result.votes < kMinVotes || best.weight < 1.3 * rival) return result;

  // Similarity by least squares over the votes (Umeyama), in full-resolution pixels.
  Eigen::Matrix2Xd from(2, result.votes), to(2, result.votes);
  for (int i = 0; i < result.votes; ++i) {
    from.col(i) = best.votes[static_cast<std::size_t>(i)].reference;
    to.col(i) = best.votes[static_cast<std::size_t>(i)].target;
  }
  const double full = std::ldexp(1.0, level);
  const Eigen::Matrix3d S = Eigen::umeyama(from, to, true);
  const double scale = S.block<2, 1>(0, 0).norm();
  const double angle = std::atan2(S(1, 0), S(0, 0));
  const bool plausible = S.allFinite() && std::abs(scale / best.scale - 1) < 0.2 &&
                         angle_between(angle, best.angle_rad) < kStep;
  if (plausible) {
    result.scale = scale;
    result.angle_rad = angle;
    result.t_px = full * S.block<2, 1>(0, 2);
  } else {  // the votes lie too close together to give more than a translation
    result.scale = best.scale;
    result.angle_rad = best.angle_rad;
    result.t_px = full * (to.rowwise().mean() - result.linear() * from.rowwise().mean());
  }
  result.valid = true;
  return result;
}

}  // namespace corvid
