#include "frontend/pair_matcher.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "frontend/align.h"
#include "frontend/disambiguate/highest_scores.h"
#include "frontend/disambiguate/weak_corners.h"
#include "frontend/epipolar.h"
#include "frontend/motion_field.h"
#include "frontend/track_search.h"

namespace corvid {
namespace {

constexpr int kMinSidePx = 48;      // of the smallest pyramid level
constexpr int kCoarseSidePx = 320;  // widest side of the level that is searched in full
constexpr int kCoarsePoints = 300;  // templates of the full search
constexpr int kLevelPoints = 2000;  // templates of each level between it and the full resolution
constexpr int kMinAgreeing = 3;     // of 8 neighbours that must have moved alike
constexpr int kMinSeeds = 12;       // matches of the coarse level that agree
constexpr double kCoarseMinScore = 0.6;

/// One search of many templates: where each is looked for and how it is warped.
struct Query {
  std::size_t point = 0;                             ///< in the list of points
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();  ///< of the window [px]
  double radius_x_px = 0, radius_y_px = 0;           ///< full resolution
  Eigen::Matrix2d warp = Eigen::Matrix2d::Identity();
};

/// With what is searched, and what counts.
struct Measure {
  int template_px = 11;
  double min_score = 0;
};

struct Matched {
  std::vector<Eigen::Vector2d> from, to;
  void add(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    from.push_back(a);
    to.push_back(b);
  }
};

/// Drops the matches whose neighbours moved otherwise, twice: the wrong ones spoil the first round.
Matched keep_agreeing(Matched matched, const Eigen::Matrix2d& prior, double share,
                      double slack_px) {
  for (int round = 0; round < 2 && !matched.from.empty(); ++round) {
    const auto agreement = MotionField(matched.from, matched.to, prior).agreement(share, slack_px);
    Matched kept;
    for (std::size_t i = 0; i < agreement.size(); ++i)
      if (agreement[i] >= kMinAgreeing) kept.add(matched.from[i], matched.to[i]);
    matched = std::move(kept);
  }
  return matched;
}

}  // namespace

struct PairMatcher::Impl {
  MatchingOptions options;
  PyramidBuilder pyramids;
  CornerDetector corners;
  NccMatcher ncc;

  [[nodiscard]] std::vector<Eigen::Vector2d> detect(const DevicePyramid& pyramid, int level,
                                                    int most,
                                                    std::span<const Eigen::Vector2d> occupied);
  /// Candidates of each query, best first; pixels of the full resolution.
  [[nodiscard]] std::vector<std::vector<SearchCandidate>> search(
      const MatchView& reference, const MatchView& target, std::span<const Eigen::Vector2d> points,
      std::span<const Query> queries, int level, const Measure& measure);
  /// The best candidate of each point where there is no other nearly as good.
  [[nodiscard]] Matched unambiguous(const MatchView& reference, const MatchView& target,
                                    std::span<const Eigen::Vector2d> points,
                                    std::span<const Query> queries, int level);
  [[nodiscard]] Matched coarse(const MatchView& reference, const MatchView& target, int level,
                               const PairKnowledge& known, Eigen::Matrix2d& prior);
  [[nodiscard]] Matched turned(const MatchView& reference, const MatchView& target, int level,
                               Eigen::Matrix2d& prior);
  [[nodiscard]] MatchSets candidate_sets(const MatchView& reference, const MatchView& target,
                                         std::span<const Query> queries, const Measure& measure,
                                         std::vector<bool>& weak);
};

PairMatcher::PairMatcher(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PairMatcher::~PairMatcher() = default;

Expected<std::unique_ptr<PairMatcher>> PairMatcher::create(std::shared_ptr<Device> device,
                                                           const MatchingOptions& options) {
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
  return std::unique_ptr<PairMatcher>(new PairMatcher(std::make_unique<Impl>(
      Impl{options, std::move(*pyramids), std::move(*corners), std::move(*ncc)})));
}

std::vector<Eigen::Vector2d> PairMatcher::Impl::detect(const DevicePyramid& pyramid, int level,
                                                       int most,
                                                       std::span<const Eigen::Vector2d> occupied) {
  const DeviceImage& image = pyramid.level(level);
  const double area = static_cast<double>(image.width_px) * image.height_px;
  const double spacing_px = std::sqrt(area / most);
  std::vector<Eigen::Vector2f> taken;
  for (const Eigen::Vector2d& x : occupied) taken.push_back(x.cast<float>());
  CornerOptions corner_options;
  corner_options.quality = options.corner_quality;
  corner_options.kappa = options.harris_kappa;
  corner_options.cell_px = std::max(8, static_cast<int>(1.5 * spacing_px));
  corner_options.max_per_cell = 3;
  corner_options.max_count = std::max(0, most - static_cast<int>(occupied.size()));
  corner_options.border_px = options.template_px / 2 + 2;
  corner_options.occupied = taken;
  corner_options.min_distance_px = std::max(4.0, 0.5 * spacing_px);
  std::vector<Eigen::Vector2d> points;
  for (const Corner& corner : corners.detect(image, corner_options))
    points.push_back(Eigen::Vector2d(corner.x_px, corner.y_px) * std::ldexp(1.0, level));
  return points;
}

MatchView PairMatcher::prepare(const GreyImage& image, const Camera& camera,
                               std::span<const Eigen::Vector2d> carried) {
  int levels = 1;
  while ((std::min(image.width(), image.height()) >> levels) >= kMinSidePx) ++levels;
  MatchView view;
  view.camera = camera;
  view.pyramid = impl_->pyramids.build(image, levels, Lane::tracking);
  view.points.assign(carried.begin(), carried.end());
  const auto corners = impl_->detect(*view.pyramid, 0, impl_->options.max_points, carried);
  view.points.insert(view.points.end(), corners.begin(), corners.end());
  for (int level = 1; level < view.pyramid->levels(); ++level) {
    view.level_points.push_back(impl_->detect(*view.pyramid, level, kLevelPoints, {}));
    const DeviceImage& size = view.pyramid->level(level);
    if (std::max(size.width_px, size.height_px) <= kCoarseSidePx) break;
  }
  return view;
}

std::vector<std::vector<SearchCandidate>> PairMatcher::Impl::search(
    const MatchView& reference, const MatchView& target, std::span<const Eigen::Vector2d> points,
    std::span<const Query> queries, int level, const Measure& measure) {
  const double scale = std::ldexp(1.0, -level);
  std::vector<NccJob> jobs;
  jobs.reserve(queries.size());
  for (const Query& query : queries) {
    NccJob job;
    const Eigen::Vector2d& x = points[query.point];
    job.template_x_px = static_cast<float>(x.x() * scale);
    job.template_y_px = static_cast<float>(x.y() * scale);
    for (int k = 0; k < 4; ++k) job.warp[k] = static_cast<float>(query.warp(k / 2, k % 2));
    job.window_x_px = static_cast<std::int32_t>(std::lround(query.centre.x() * scale));
    job.window_y_px = static_cast<std::int32_t>(std::lround(query.centre.y() * scale));
    job.radius_x_px = static_cast<std::int32_t>(std::ceil(query.radius_x_px * scale));
    job.radius_y_px = static_cast<std::int32_t>(std::ceil(query.radius_y_px * scale));
    jobs.push_back(job);
  }
  NccOptions ncc_options;
  ncc_options.template_px = measure.template_px;
  ncc_options.peak_quality = options.peak_quality;
  if (level > 0) ncc_options.align_iterations = 0;
  const auto results = ncc.match(reference.pyramid->level(level), target.pyramid->level(level),
                                 jobs, ncc_options, Lane::tracking);
  std::vector<std::vector<SearchCandidate>> candidates(queries.size());
  for (std::size_t i = 0; i < results.size(); ++i)
    for (int k = 0; k < results[i].count; ++k) {
      const NccPeak& peak = results[i].peaks[static_cast<std::size_t>(k)];
      if (peak.score >= measure.min_score) candidates[i].push_back(to_candidate(peak, level));
    }
  return candidates;
}

Matched PairMatcher::Impl::unambiguous(const MatchView& reference, const MatchView& target,
                                       std::span<const Eigen::Vector2d> points,
                                       std::span<const Query> queries, int level) {
  const auto candidates =
      search(reference, target, points, queries, level, {options.template_px, kCoarseMinScore});
  Matched matched;
  for (std::size_t i = 0; i < queries.size(); ++i) {
    const auto& list = candidates[i];
    if (list.empty()) continue;
    if (list.size() > 1 &&
        list[0].score < options.disambiguation.ratio_highest_scores * list[1].score)
      continue;
    matched.add(points[queries[i].point], list[0].pixel);
  }
  return matched;
}

Matched PairMatcher::Impl::coarse(const MatchView& reference, const MatchView& target, int level,
                                  const PairKnowledge& known, Eigen::Matrix2d& prior) {
  (void)known;
  const auto& all =
      level == 0 ? reference.points : reference.level_points[static_cast<std::size_t>(level - 1)];
  const std::span<const Eigen::Vector2d> points(all.data(),
                                                std::min<std::size_t>(all.size(), kCoarsePoints));
  const DeviceImage& image = target.pyramid->level(0);
  std::vector<Query> queries;
  for (std::size_t i = 0; i < points.size(); ++i)
    queries.push_back({i, Eigen::Vector2d(0.5 * image.width_px, 0.5 * image.height_px),
                       0.5 * image.width_px, 0.5 * image.height_px, prior.inverse()});
  return keep_agreeing(unambiguous(reference, target, points, queries, level), prior, 0.35,
                       std::ldexp(2.0, level));
}

Matched PairMatcher::Impl::turned(const MatchView& reference, const MatchView& target, int level,
                                  Eigen::Matrix2d& prior) {
  const ImageSimilarity similarity = align_images(ncc, *reference.pyramid, *target.pyramid);
  if (!similarity.valid) return {};
  prior = similarity.linear();
  const auto& points =
      level == 0 ? reference.points : reference.level_points[static_cast<std::size_t>(level - 1)];
  const DeviceImage& image = target.pyramid->level(0);
  const double radius_px = 0.1 * std::max(image.width_px, image.height_px);
  std::vector<Query> queries;
  for (std::size_t i = 0; i < points.size(); ++i)
    queries.push_back({i, similarity(points[i]), radius_px, radius_px, prior.inverse()});
  return keep_agreeing(unambiguous(reference, target, points, queries, level), prior, 0.35,
                       std::ldexp(2.0, level));
}

MatchSets PairMatcher::Impl::candidate_sets(const MatchView& reference, const MatchView& target,
                                            std::span<const Query> queries, const Measure& measure,
                                            std::vector<bool>& weak) {
  auto candidates = search(reference, target, reference.points, queries, 0, measure);
  std::vector<Eigen::Vector2f> x_r, x_t;
  for (std::size_t i = 0; i < queries.size(); ++i) {
    x_r.push_back(reference.points[queries[i].point].cast<float>());
    for (const SearchCandidate& candidate : candidates[i])
      x_t.push_back(candidate.pixel.cast<float>());
  }
  const auto score_r = corners.score_at(reference.pyramid->level(0), x_r, options.harris_kappa);
  const DeviceImage& image = target.pyramid->level(0);
  const auto score_t = corners.score_at(image, x_t, options.harris_kappa);
  MatchSets sets;
  sets.points.resize(queries.size());
  std::size_t next = 0;
  for (std::size_t i = 0; i < queries.size(); ++i) {
    MatchSets::Point& point = sets.points[i];
    const auto undistorted = undistort_pixel(reference.camera, reference.points[queries[i].point]);
    point.x_r = undistorted.value_or(reference.points[queries[i].point]);
    for (const SearchCandidate& candidate : candidates[i]) {
      const std::size_t k = next++;
      if (is_weak_corner(score_r[i].lambda_min, score_t[k].lambda_min, x_t[k], image.width_px,
                         image.height_px, options.corner_score_ratio)) {
        weak[queries[i].point] = true;
        continue;
      }
      const auto pixel = undistort_pixel(target.camera, candidate.pixel);
      if (!undistorted || !pixel) continue;
      point.candidates.push_back(candidate);
      point.x_t.push_back(*pixel);
    }
  }
  return sets;
}

PairMatches PairMatcher::match(const MatchView& reference, const MatchView& target,
                               const PairKnowledge& known) {
  Impl& impl = *impl_;
  const DisambiguationOptions& rules = impl.options.disambiguation;
  PairMatches result;
  Stopwatch watch;
  const auto refuse = [&](std::string why) {
    result.refusal = std::move(why);
    for (std::size_t i = 0; i < reference.points.size(); ++i)
      result.unmatched.push_back({i, NoMatch::no_candidate, {}});
    return result;
  };
  if (reference.points.size() < static_cast<std::size_t>(rules.min_matches))
    return refuse(fmt::format("the reference has {} interest points, fewer than {}",
                              reference.points.size(), rules.min_matches));
  const int coarse_level =
      std::min(static_cast<int>(reference.level_points.size()), target.pyramid->levels() - 1);

  // From nothing: the whole coarse target, as it stands; if that gives little, turned and scaled.
  Eigen::Matrix2d prior = Eigen::Matrix2d::Identity();
  Matched matched = impl.coarse(reference, target, coarse_level, known, prior);
  result.timings.emplace_back("coarse", watch.lap_ms());
  if (matched.from.size() < kCoarsePoints / 8) {
    Eigen::Matrix2d turn = prior;
    Matched other = impl.turned(reference, target, coarse_level, turn);
    if (other.from.size() > 2 * matched.from.size()) {
      matched = std::move(other);
      prior = turn;
    }
    result.timings.emplace_back("turned", watch.lap_ms());
  }
  if (matched.from.size() < kMinSeeds)
    return refuse(fmt::format("only {} features of the coarse images agree", matched.from.size()));

  // Down the pyramid, led by the neighbours.
  const DeviceImage& image = target.pyramid->level(0);
  const auto guided = [&](std::span<const Eigen::Vector2d> points, int level, double least_px) {
    const MotionField field(matched.from, matched.to, prior);
    const auto motions = field.at(points);
    std::vector<Query> queries;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const LocalMotion& motion = motions[i];
      const double area = motion.linear.determinant();
      if (!(area > 0.1) || !(area < 10)) continue;
      if (!(motion.x_t.x() > 0) || !(motion.x_t.y() > 0) || !(motion.x_t.x() < image.width_px) ||
          !(motion.x_t.y() < image.height_px))
        continue;
      const double radius_px =
          std::ldexp(std::clamp(3 * std::ldexp(motion.spread_px, -level), least_px, 10.0), level);
      queries.push_back({i, motion.x_t, radius_px, radius_px, motion.linear.inverse()});
    }
    return queries;
  };
  for (int level = coarse_level; level >= 1; --level) {
    const auto& points = reference.level_points[static_cast<std::size_t>(level - 1)];
    const auto queries = guided(points, level, 4);
    Matched next = keep_agreeing(impl.unambiguous(reference, target, points, queries, level), prior,
                                 0.25, std::ldexp(1.5, level));
    if (next.from.size() >= kMinSeeds) matched = std::move(next);
    result.timings.emplace_back(fmt::format("level {}", level), watch.lap_ms());
  }

  // Full resolution: small windows first, which give the geometry.
  std::vector<bool> weak(reference.points.size(), false);
  auto queries = guided(reference.points, 0, 4);
  MatchSets sets = impl.candidate_sets(reference, target, queries,
                                       {impl.options.template_px, impl.options.min_score}, weak);
  result.timings.emplace_back("native", watch.lap_ms());
  Disambiguation told = disambiguate(sets, rules, known.F);
  result.timings.emplace_back("disambiguate", watch.lap_ms());
  if (!told.F) return refuse("the matches do not agree on an epipolar geometry");

  // Then again with the warps that these matches give: what was found is measured anew, what was
  // not is looked for along its epipolar line.
  matched = {};
  std::vector<std::optional<Eigen::Vector2d>> place(reference.points.size());
  for (std::size_t i = 0; i < queries.size(); ++i) {
    const auto& point = sets.points[i];
    if (!point.accepted) continue;
    const std::size_t k = queries[i].point;
    place[k] = point.candidates[*point.accepted].pixel;
    matched.add(reference.points[k], *place[k]);
  }
  queries = guided(reference.points, 0, 4);
  for (Query& query : queries)
    if (place[query.point]) {
      query.centre = *place[query.point];
      query.radius_x_px = query.radius_y_px = 2;
    }
  sets =
      impl.candidate_sets(reference, target, queries,
                          {impl.options.refine_template_px, impl.options.refine_min_score}, weak);
  result.timings.emplace_back("refine", watch.lap_ms());
  told = disambiguate(sets, rules, told.F, known.auxiliary);
  result.timings.emplace_back("disambiguate again", watch.lap_ms());
  if (!told.F) return refuse("the matches do not agree on an epipolar geometry");
  result.F = told.F;
  result.disambiguation = std::move(told.report);

  std::vector<std::optional<std::size_t>> query_of(reference.points.size());
  for (std::size_t i = 0; i < queries.size(); ++i) query_of[queries[i].point] = i;
  for (std::size_t k = 0; k < reference.points.size(); ++k) {
    if (!query_of[k]) {
      result.unmatched.push_back({k, NoMatch::no_candidate, {}});
      continue;
    }
    const MatchSets::Point& point = sets.points[*query_of[k]];
    if (point.accepted) {
      const SearchCandidate& candidate = point.candidates[*point.accepted];
      result.matches.push_back({k, reference.points[k], candidate.pixel, candidate.score,
                                candidate.covariance_px2, queries[*query_of[k]].warp});
      continue;
    }
    UnmatchedPoint unmatched{k, NoMatch::geometry, {}};
    for (const SearchCandidate& candidate : point.candidates)
      unmatched.candidates.push_back(candidate.pixel);
    if (!point.candidates.empty())
      unmatched.reason = NoMatch::ambiguous;
    else if (weak[k])
      unmatched.reason = NoMatch::weak_corner;
    result.unmatched.push_back(std::move(unmatched));
  }
  return result;
}

}  // namespace corvid
