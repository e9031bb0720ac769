#include "frontend/pair_search.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/check.h"
#include "frontend/align.h"
#include "frontend/disambiguate/weak_corners.h"
#include "frontend/epipolar.h"
#include "frontend/spread_corners.h"

namespace corvid {
namespace {

constexpr int kCoarsePoints = 300;  // templates of the full search
constexpr int kMinAgreeing = 3;     // of 8 neighbours that must have moved alike
constexpr double kCoarseMinScore = 0.6;
constexpr double kStripHeightPx = 10;  // of a strip along an epipolar line, at its level
constexpr int kAlignIterations = 8;  // of Gauss-Newton, from the vertex; 4 lose 1 % of the matches
constexpr double kPiecePx = 24;      // length of a strip's windows
constexpr double kMostDepthPx = 48;  // along the epipolar line, to either side of the prediction

/// The peaks of windows that overlap become one list, best first, without repetitions.
void merge_peaks(std::vector<SearchCandidate>& peaks, double quality, double apart_px) {
  std::stable_sort(peaks.begin(), peaks.end(),
                   [](const auto& a, const auto& b) { return a.score > b.score; });
  std::vector<SearchCandidate> kept;
  for (const SearchCandidate& peak : peaks) {
    if (!kept.empty() && peak.score < quality * kept.front().score) break;
    if (std::none_of(kept.begin(), kept.end(), [&](const SearchCandidate& other) {
          return (other.pixel - peak.pixel).norm() < apart_px;
        }))
      kept.push_back(peak);
  }
  peaks = std::move(kept);
}

}  // namespace

bool usable_warp(const Eigen::Matrix2d& linear) {
  const double area = linear.determinant();
  return area > 0.1 && area < 10;
}

PairPlaces keep_agreeing(PairPlaces matched, const Eigen::Matrix2d& prior, double share,
                         double slack_px) {
  for (int round = 0; round < 2 && !matched.from.empty(); ++round) {
    const auto agreement = MotionField(matched.from, matched.to, prior).agreement(share, slack_px);
    PairPlaces kept;
    for (std::size_t i = 0; i < agreement.size(); ++i)
      if (agreement[i] >= kMinAgreeing) kept.add(matched.from[i], matched.to[i]);
    matched = std::move(kept);
  }
  return matched;
}

Expected<std::unique_ptr<PairSearch>> PairSearch::create(std::shared_ptr<Device> device,
                                                         const MatchingOptions& options,
                                                         Lane lane) {
  auto pyramids = PyramidBuilder::create(device);
  if (!pyramids) return tl::unexpected(pyramids.error());
  auto corners = CornerDetector::create(device);
  if (!corners) return tl::unexpected(corners.error());
  auto ncc = NccMatcher::create(device);
  if (!ncc) return tl::unexpected(ncc.error());
  NccOptions ncc_options;
  ncc_options.template_px = options.template_px;
  if (const auto ready = ncc->prepare(ncc_options); !ready) return tl::unexpected(ready.error());
  ncc_options.template_px = options.refine_template_px;
  if (const auto ready = ncc->prepare(ncc_options); !ready) return tl::unexpected(ready.error());
  return std::unique_ptr<PairSearch>(
      new PairSearch(options, lane, std::move(*pyramids), std::move(*corners), std::move(*ncc)));
}

std::shared_ptr<const DevicePyramid> PairSearch::pyramid(const GreyImage& image, int levels) {
  return pyramids_.build(image, levels, lane_);
}

std::vector<Eigen::Vector2d> PairSearch::detect(const DevicePyramid& pyramid, int level, int most,
                                                std::span<const Eigen::Vector2d> occupied) {
  const DeviceImage& image = pyramid.level(level);
  std::vector<Eigen::Vector2f> taken;
  for (const Eigen::Vector2d& x : occupied) taken.push_back(x.cast<float>());
  CornerOptions corner_options = spread_corners(image, most, options_.template_px, taken);
  corner_options.quality = options_.corner_quality;
  corner_options.kappa = options_.harris_kappa;
  std::vector<Eigen::Vector2d> points;
  for (const Corner& corner : corners_.detect(image, corner_options, lane_))
    points.push_back(Eigen::Vector2d(corner.x_px, corner.y_px) * std::ldexp(1.0, level));
  return points;
}

std::vector<std::vector<SearchCandidate>> PairSearch::search(
    const MatchView& reference, const MatchView& target, std::span<const Eigen::Vector2d> points,
    std::span<const PairQuery> queries, int level, const PairMeasure& measure) {
  const double scale = std::ldexp(1.0, -level);
  std::vector<NccJob> jobs;
  std::vector<std::size_t> owner;
  for (std::size_t i = 0; i < queries.size(); ++i)
    for (const SearchWindow& window : queries[i].windows) {
      NccJob job;
      const Eigen::Vector2d& x = points[queries[i].point];
      job.template_x_px = static_cast<float>(x.x() * scale);
      job.template_y_px = static_cast<float>(x.y() * scale);
      for (int k = 0; k < 4; ++k) job.warp[k] = static_cast<float>(queries[i].warp(k / 2, k % 2));
      job.window_x_px = static_cast<std::int32_t>(std::lround(window.centre.x() * scale));
      job.window_y_px = static_cast<std::int32_t>(std::lround(window.centre.y() * scale));
      job.radius_x_px = static_cast<std::int32_t>(std::ceil(window.radius_x_px * scale));
      job.radius_y_px = static_cast<std::int32_t>(std::ceil(window.radius_y_px * scale));
      jobs.push_back(job);
      owner.push_back(i);
    }
  NccOptions ncc_options;
  ncc_options.template_px = measure.template_px;
  ncc_options.peak_quality = options_.peak_quality;
  ncc_options.align_iterations = measure.exact ? kAlignIterations : 0;
  const auto results = ncc_.match(reference.pyramid->level(level), target.pyramid->level(level),
                                  jobs, ncc_options, lane_);
  std::vector<std::vector<SearchCandidate>> candidates(queries.size());
  for (std::size_t j = 0; j < results.size(); ++j)
    for (int k = 0; k < results[j].count; ++k) {
      const NccPeak& peak = results[j].peaks[static_cast<std::size_t>(k)];
      if (peak.score >= measure.min_score)
        candidates[owner[j]].push_back(to_candidate(peak, level));
    }
  for (std::size_t i = 0; i < queries.size(); ++i)
    if (queries[i].windows.size() > 1)
      merge_peaks(candidates[i], options_.peak_quality, std::ldexp(1.0, level));
  return candidates;
}

PairPlaces PairSearch::unambiguous(const MatchView& reference, const MatchView& target,
                                   std::span<const Eigen::Vector2d> points,
                                   std::span<const PairQuery> queries, int level) {
  const auto candidates =
      search(reference, target, points, queries, level, {options_.template_px, kCoarseMinScore});
  PairPlaces matched;
  for (std::size_t i = 0; i < queries.size(); ++i) {
    const auto& list = candidates[i];
    if (list.empty()) continue;
    if (list.size() > 1 &&
        list[0].score < options_.disambiguation.ratio_highest_scores * list[1].score)
      continue;
    matched.add(points[queries[i].point], list[0].pixel);
  }
  return matched;
}

PairPlaces PairSearch::coarse(const MatchView& reference, const MatchView& target, int level,
                              const PairKnowledge& known, const Eigen::Matrix2d& prior,
                              std::size_t& asked) {
  const auto& all =
      level == 0 ? reference.points : reference.level_points[static_cast<std::size_t>(level - 1)];
  // Evenly from the list, whose first points are the strongest of their cells.
  std::vector<Eigen::Vector2d> points;
  asked = std::min<std::size_t>(all.size(), kCoarsePoints);
  for (std::size_t i = 0; i < asked; ++i) points.push_back(all[i * all.size() / asked]);
  const Camera& camera = target.camera;
  const double px = std::ldexp(1.0, level);  // of the level
  const Eigen::Vector2d middle(0.5 * camera.width_px, 0.5 * camera.height_px);
  std::vector<PairQuery> queries;
  for (std::size_t i = 0; i < points.size(); ++i) {
    PairQuery query{i, {}, prior.inverse()};
    if (!known.F) {
      query.windows.push_back({middle, middle.x(), middle.y()});
    } else if (const auto x_r = undistort_pixel(reference.camera, points[i])) {
      if (const auto ends = clip_line(*known.F * x_r->homogeneous(), camera, 4 * px))
        query.windows = strip_windows(camera, ends->first, ends->second, kStripHeightPx / 2 * px,
                                      kPiecePx * px);
    }
    queries.push_back(std::move(query));
  }
  return keep_agreeing(unambiguous(reference, target, points, queries, level), prior, 0.35, 2 * px);
}

PairPlaces PairSearch::turned(const MatchView& reference, const MatchView& target, int level,
                              Eigen::Matrix2d& prior) {
  const ImageSimilarity similarity = align_images(ncc_, *reference.pyramid, *target.pyramid, lane_);
  if (!similarity.valid) return {};
  prior = similarity.linear();
  const auto& points =
      level == 0 ? reference.points : reference.level_points[static_cast<std::size_t>(level - 1)];
  const DeviceImage& image = target.pyramid->level(0);
  const double radius_px = 0.1 * std::max(image.width_px, image.height_px);
  std::vector<PairQuery> queries;
  for (std::size_t i = 0; i < points.size(); ++i)
    queries.push_back({i, {{similarity(points[i]), radius_px, radius_px}}, prior.inverse()});
  return keep_agreeing(unambiguous(reference, target, points, queries, level), prior, 0.35,
                       std::ldexp(2.0, level));
}

std::vector<SearchWindow> PairSearch::strip(const MatchView& reference, const MatchView& target,
                                            const MotionField& field, const LocalMotion& motion,
                                            const Eigen::Matrix3d& F, std::size_t point) {
  const auto x_r = undistort_pixel(reference.camera, reference.points[point]);
  if (!x_r) return {};
  const auto predicted = undistort_pixel(target.camera, motion.x_t);
  const Eigen::Vector3d line = F * x_r->homogeneous();
  const double norm = line.head<2>().norm();
  if (!predicted || !(norm > 1e-300)) return {};
  const Eigen::Vector2d normal = line.head<2>() / norm, direction(-normal.y(), normal.x());
  const Eigen::Vector2d foot = *predicted - normal * (normal.dot(*predicted) + line.z() / norm);
  auto [least, most] = field.range_along(reference.points[point], motion, direction);
  least = std::max(least, -kMostDepthPx) - 4;
  most = std::min(most, kMostDepthPx) + 4;
  return strip_windows(target.camera, foot + least * direction, foot + most * direction, 3,
                       kPiecePx);
}

MatchSets PairSearch::candidate_sets(const MatchView& reference, const MatchView& target,
                                     std::span<const PairQuery> queries, const PairMeasure& measure,
                                     std::vector<bool>& weak) {
  auto candidates = search(reference, target, reference.points, queries, 0, measure);
  std::vector<Eigen::Vector2d> x_r;
  for (const PairQuery& query : queries) x_r.push_back(reference.points[query.point]);
  const auto weak_candidates =
      take_weak_corners(corners_, reference.pyramid->level(0), target.pyramid->level(0), 0, x_r,
                        options_.harris_kappa, options_.corner_score_ratio, candidates, lane_);
  MatchSets sets;
  sets.points.resize(queries.size());
  for (std::size_t i = 0; i < queries.size(); ++i) {
    MatchSets::Point& point = sets.points[i];
    for (const SearchCandidate& candidate : weak_candidates[i]) {
      weak[queries[i].point] = true;
      point.refused.push_back(candidate.pixel);
    }
    const auto undistorted = undistort_pixel(reference.camera, x_r[i]);
    point.x_r = undistorted.value_or(x_r[i]);
    for (const SearchCandidate& candidate : candidates[i]) {
      const auto pixel = undistort_pixel(target.camera, candidate.pixel);
      if (!undistorted || !pixel) continue;
      point.candidates.push_back(candidate);
      point.x_t.push_back(*pixel);
    }
  }
  return sets;
}

std::vector<AuxiliaryView> PairSearch::third_views(const MatchView& reference,
                                                   std::span<const PairQuery> queries,
                                                   std::span<const AuxiliaryMatches> auxiliary) {
  std::vector<AuxiliaryView> views;
  for (const AuxiliaryMatches& third : auxiliary) {
    CORVID_CHECK(third.view && third.x_a.size() == reference.points.size(),
                 "auxiliary matches are of the reference's points");
    AuxiliaryView view;
    view.F_auxiliary_reference = third.F_auxiliary_reference;
    view.F_auxiliary_target = third.F_auxiliary_target;
    view.peak_quality = options_.peak_quality;
    PairPlaces matched;
    for (const PairQuery& query : queries) {
      const auto& x_a = third.x_a[query.point];
      view.x_a.push_back(x_a ? undistort_pixel(third.view->camera, *x_a) : std::nullopt);
      if (x_a) matched.add(reference.points[query.point], *x_a);
    }
    if (!matched.from.empty()) {
      auto field = std::make_shared<const MotionField>(matched.from, matched.to,
                                                       Eigen::Matrix2d::Identity());
      view.support = [this, &reference, &third, queries,
                      field](std::span<const AuxiliaryView::Probe> probes) {
        return support(reference, *third.view, queries, *field, probes);
      };
    }
    views.push_back(std::move(view));
  }
  return views;
}

std::vector<float> PairSearch::support(const MatchView& reference, const MatchView& auxiliary,
                                       std::span<const PairQuery> queries, const MotionField& field,
                                       std::span<const AuxiliaryView::Probe> probes) {
  std::vector<Eigen::Vector2d> places;
  for (const AuxiliaryView::Probe& probe : probes)
    places.push_back(reference.points[queries[probe.point].point]);
  const auto motions = field.at(places);
  const auto distorted = [&](const Eigen::Vector2d& x) {
    const Camera& camera = auxiliary.camera;
    return camera.project(Eigen::Vector3d((x.x() - camera.cx_px) / camera.fx_px,
                                          (x.y() - camera.cy_px) / camera.fy_px, 1));
  };
  // The window of thesis 4.4.11 has 31 x 7 candidates along the line, and must lie in the image.
  constexpr double kAlongPx = 15, kAcrossPx = 3;
  const double border_px = options_.template_px / 2 + kAlongPx;
  std::vector<PairQuery> asked;
  for (std::size_t i = 0; i < probes.size(); ++i) {
    PairQuery query{queries[probes[i].point].point, {}, Eigen::Matrix2d::Identity()};
    const auto pixel = distorted(probes[i].place);
    if (usable_warp(motions[i].linear) && pixel && auxiliary.camera.in_image(*pixel, border_px)) {
      const Eigen::Vector2d reach = kAlongPx * probes[i].line_direction;
      query.windows = strip_windows(auxiliary.camera, probes[i].place - reach,
                                    probes[i].place + reach, kAcrossPx, 8);
      query.warp = motions[i].linear.inverse();
    }
    asked.push_back(std::move(query));
  }
  const auto candidates = search(reference, auxiliary, reference.points, asked, 0,
                                 {options_.template_px, options_.min_score});
  std::vector<float> scores(probes.size(), std::numeric_limits<float>::quiet_NaN());
  for (std::size_t i = 0; i < probes.size(); ++i) {
    if (asked[i].windows.empty()) continue;
    scores[i] = -1;
    const Eigen::Vector2d along = probes[i].line_direction, across(-along.y(), along.x());
    for (const SearchCandidate& candidate : candidates[i]) {
      const auto x = undistort_pixel(auxiliary.camera, candidate.pixel);
      if (!x || std::abs(across.dot(*x - probes[i].place)) > kAcrossPx) continue;
      scores[i] = candidate.score;
      break;
    }
  }
  return scores;
}

}  // namespace corvid
