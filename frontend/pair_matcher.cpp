#include "frontend/pair_matcher.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "core/check.h"
#include "frontend/align.h"
#include "frontend/disambiguate/highest_scores.h"
#include "frontend/disambiguate/weak_corners.h"
#include "frontend/epipolar.h"
#include "frontend/epipolar_strip.h"
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
constexpr double kStripHeightPx = 10;    // of a strip along an epipolar line, at its level
constexpr double kSelectionSlack = 2.5;  // on tau_f, until the last measurement
// Of the points that should be in view. True pairs: 0.3 and more; views of other parts of a scene
// with the same kinds of texture: up to 0.05.
constexpr double kMinShare = 0.08;
constexpr double kPiecePx = 24;      // length of a strip's windows
constexpr double kMostDepthPx = 48;  // along the epipolar line, to either side of the prediction

/// Where a template is looked for, and how it is warped (target offsets to reference offsets).
struct Query {
  std::size_t point = 0;              ///< in the list of points
  std::vector<SearchWindow> windows;  ///< full resolution
  Eigen::Matrix2d warp = Eigen::Matrix2d::Identity();
};

/// With what is searched, and what counts.
struct Measure {
  int template_px = 11;
  double min_score = 0;
  bool exact = false;  ///< peaks are aligned on the images; else the quadratic's vertex will do
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
                               const PairKnowledge& known, const Eigen::Matrix2d& prior);
  [[nodiscard]] Matched turned(const MatchView& reference, const MatchView& target, int level,
                               Eigen::Matrix2d& prior);
  /// The part of a point's epipolar line where its neighbours' depths would put it.
  [[nodiscard]] static std::vector<SearchWindow> strip(const MatchView& reference,
                                                       const MatchView& target,
                                                       const MotionField& field,
                                                       const Eigen::Matrix3d& F, std::size_t point);
  /// What disambiguate() needs to know of auxiliary images, for the points of the queries. The
  /// views refer to the arguments.
  [[nodiscard]] std::vector<AuxiliaryView> third_views(const MatchView& reference,
                                                       std::span<const Query> queries,
                                                       std::span<const AuxiliaryMatches> auxiliary,
                                                       const Eigen::Matrix2d& prior);
  /// AuxiliaryView::support.
  [[nodiscard]] std::vector<float> support(const MatchView& reference, const MatchView& auxiliary,
                                           std::span<const Query> queries, const MotionField& field,
                                           std::span<const AuxiliaryView::Probe> probes);
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
  ncc_options.peak_quality = options.peak_quality;
  if (!measure.exact) ncc_options.align_iterations = 0;
  const auto results = ncc.match(reference.pyramid->level(level), target.pyramid->level(level),
                                 jobs, ncc_options, Lane::tracking);
  std::vector<std::vector<SearchCandidate>> candidates(queries.size());
  for (std::size_t j = 0; j < results.size(); ++j)
    for (int k = 0; k < results[j].count; ++k) {
      const NccPeak& peak = results[j].peaks[static_cast<std::size_t>(k)];
      if (peak.score >= measure.min_score)
        candidates[owner[j]].push_back(to_candidate(peak, level));
    }
  for (std::size_t i = 0; i < queries.size(); ++i)
    if (queries[i].windows.size() > 1)
      merge_peaks(candidates[i], options.peak_quality, std::ldexp(1.0, level));
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
                                  const PairKnowledge& known, const Eigen::Matrix2d& prior) {
  const auto& all =
      level == 0 ? reference.points : reference.level_points[static_cast<std::size_t>(level - 1)];
  const std::span<const Eigen::Vector2d> points(all.data(),
                                                std::min<std::size_t>(all.size(), kCoarsePoints));
  const Camera& camera = target.camera;
  const double px = std::ldexp(1.0, level);  // of the level
  const Eigen::Vector2d middle(0.5 * camera.width_px, 0.5 * camera.height_px);
  std::vector<Query> queries;
  for (std::size_t i = 0; i < points.size(); ++i) {
    Query query{i, {}, prior.inverse()};
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
    queries.push_back({i, {{similarity(points[i]), radius_px, radius_px}}, prior.inverse()});
  return keep_agreeing(unambiguous(reference, target, points, queries, level), prior, 0.35,
                       std::ldexp(2.0, level));
}

std::vector<SearchWindow> PairMatcher::Impl::strip(const MatchView& reference,
                                                   const MatchView& target,
                                                   const MotionField& field,
                                                   const Eigen::Matrix3d& F, std::size_t point) {
  const auto x_r = undistort_pixel(reference.camera, reference.points[point]);
  if (!x_r) return {};
  const LocalMotion motion = field.at(reference.points[point]);
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
  // Corner scores go with the square of the exposure: they are compared after the typical ratio.
  std::vector<double> ratios;
  for (std::size_t i = 0, k = 0; i < queries.size(); k += candidates[i++].size())
    if (!candidates[i].empty() && score_t[k].lambda_min > 0)
      ratios.push_back(score_r[i].lambda_min / score_t[k].lambda_min);
  double exposure = 1;
  if (!ratios.empty()) {
    const auto middle = ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2);
    std::nth_element(ratios.begin(), middle, ratios.end());
    if (*middle > 0) exposure = *middle;
  }
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
                         image.height_px, exposure * options.corner_score_ratio)) {
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

std::vector<AuxiliaryView> PairMatcher::Impl::third_views(
    const MatchView& reference, std::span<const Query> queries,
    std::span<const AuxiliaryMatches> auxiliary, const Eigen::Matrix2d& prior) {
  std::vector<AuxiliaryView> views;
  for (const AuxiliaryMatches& third : auxiliary) {
    CORVID_CHECK(third.view && third.x_a.size() == reference.points.size(),
                 "auxiliary matches are of the reference's points");
    AuxiliaryView view;
    view.F_auxiliary_reference = third.F_auxiliary_reference;
    view.F_auxiliary_target = third.F_auxiliary_target;
    Matched matched;
    for (const Query& query : queries) {
      const auto& x_a = third.x_a[query.point];
      view.x_a.push_back(x_a ? undistort_pixel(third.view->camera, *x_a) : std::nullopt);
      if (x_a) matched.add(reference.points[query.point], *x_a);
    }
    if (!matched.from.empty()) {
      auto field = std::make_shared<const MotionField>(matched.from, matched.to, prior);
      view.support = [this, &reference, &third, queries,
                      field](std::span<const AuxiliaryView::Probe> probes) {
        return support(reference, *third.view, queries, *field, probes);
      };
    }
    views.push_back(std::move(view));
  }
  return views;
}

std::vector<float> PairMatcher::Impl::support(const MatchView& reference,
                                              const MatchView& auxiliary,
                                              std::span<const Query> queries,
                                              const MotionField& field,
                                              std::span<const AuxiliaryView::Probe> probes) {
  std::vector<Query> asked;
  for (const AuxiliaryView::Probe& probe : probes) {
    const std::size_t point = queries[probe.point].point;
    const LocalMotion motion = field.at(reference.points[point]);
    Query query{point, {}, Eigen::Matrix2d::Identity()};
    if (std::abs(motion.linear.determinant()) > 0.1) query.warp = motion.linear.inverse();
    const Eigen::Vector2d reach = 15 * probe.line_direction;  // 31 x 7 (thesis 4.4.11)
    query.windows =
        strip_windows(auxiliary.camera, probe.place - reach, probe.place + reach, 3, 31);
    asked.push_back(std::move(query));
  }
  const auto candidates = search(reference, auxiliary, reference.points, asked, 0,
                                 {options.template_px, options.min_score});
  std::vector<float> scores;
  for (const auto& list : candidates) scores.push_back(list.empty() ? -1.0F : list[0].score);
  return scores;
}

AuxiliaryMatches auxiliary_matches(const MatchView& reference, const MatchView& auxiliary,
                                   const PairMatches& matches) {
  AuxiliaryMatches third;
  third.view = &auxiliary;
  third.x_a.resize(reference.points.size());
  for (const PairMatch& match : matches.matches) third.x_a[match.point] = match.x_t;
  if (matches.F) third.F_auxiliary_reference = *matches.F;
  return third;
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
      queries.push_back({i, {{motion.x_t, radius_px, radius_px}}, motion.linear.inverse()});
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

  // Full resolution: small windows first, which give the geometry. Small templates are less exact
  // than the last measurement, after which tau_f holds as it is.
  DisambiguationOptions loose = rules;
  loose.max_epipolar_px *= kSelectionSlack;
  std::vector<bool> weak(reference.points.size(), false);
  const Measure first{impl.options.template_px, impl.options.min_score};
  auto queries = guided(reference.points, 0, 4);
  MatchSets sets = impl.candidate_sets(reference, target, queries, first, weak);
  result.timings.emplace_back("native", watch.lap_ms());
  Disambiguation told = disambiguate(sets, loose, known.F);
  result.timings.emplace_back("disambiguate", watch.lap_ms());
  if (!told.F) {
    result.disambiguation = std::move(told.report);
    return refuse("the matches do not agree on an epipolar geometry");
  }

  // What was not found is looked for along its epipolar line, and all is told apart again.
  const auto accepted = [&] {
    Matched found;
    for (std::size_t i = 0; i < queries.size(); ++i)
      if (const auto& point = sets.points[i]; point.accepted)
        found.add(reference.points[queries[i].point], point.candidates[*point.accepted].pixel);
    return found;
  };
  matched = accepted();
  {
    const MotionField field(matched.from, matched.to, prior);
    std::vector<Query> strips;
    std::vector<std::size_t> slots;
    for (std::size_t i = 0; i < queries.size(); ++i) {
      if (sets.points[i].accepted) continue;
      queries[i].windows = impl.strip(reference, target, field, *told.F, queries[i].point);
      strips.push_back(queries[i]);
      slots.push_back(i);
    }
    MatchSets more = impl.candidate_sets(
        reference, target, strips, {impl.options.refine_template_px, impl.options.min_score}, weak);
    for (std::size_t k = 0; k < slots.size(); ++k) {
      MatchSets::Point& point = sets.points[slots[k]];
      const Withdrawn before = point.last_withdrawn;
      point = std::move(more.points[k]);
      point.last_withdrawn = before;
    }
  }
  result.timings.emplace_back("strips", watch.lap_ms());
  told = disambiguate(sets, loose, told.F,
                      impl.third_views(reference, queries, known.auxiliary, prior));
  result.timings.emplace_back("disambiguate again", watch.lap_ms());
  result.disambiguation = std::move(told.report);
  if (!told.F) return refuse("the matches do not agree on an epipolar geometry");
  std::vector<std::optional<UnmatchedPoint>> unmatched(reference.points.size());
  for (std::size_t k = 0; k < unmatched.size(); ++k)
    unmatched[k] = UnmatchedPoint{k, NoMatch::no_candidate, {}};
  for (std::size_t i = 0; i < queries.size(); ++i) {
    const MatchSets::Point& point = sets.points[i];
    UnmatchedPoint& entry = *unmatched[queries[i].point];
    for (const SearchCandidate& candidate : point.candidates)
      entry.candidates.push_back(candidate.pixel);
    if (point.accepted) continue;  // the last measurement decides
    if (!point.candidates.empty())
      entry.reason = NoMatch::ambiguous;
    else if (point.last_withdrawn == Withdrawn::topology)
      entry.reason = NoMatch::topology;
    else if (point.last_withdrawn != Withdrawn::nothing)
      entry.reason = NoMatch::geometry;
    else if (weak[queries[i].point])
      entry.reason = NoMatch::weak_corner;
  }

  // What was accepted is measured once more, with larger templates and the warps that the matches
  // give now: as accurate as it gets.
  matched = accepted();
  if (matched.from.empty()) return refuse("no match stood the disambiguation");
  const MotionField field(matched.from, matched.to, prior);
  std::vector<Query> last;
  for (std::size_t i = 0; i < queries.size(); ++i) {
    const MatchSets::Point& point = sets.points[i];
    if (!point.accepted) continue;
    const std::size_t k = queries[i].point;
    const LocalMotion motion = field.at(reference.points[k]);
    if (!(motion.linear.determinant() > 0.1) || !(motion.linear.determinant() < 10)) continue;
    last.push_back({k, {{point.candidates[*point.accepted].pixel, 2, 2}}, motion.linear.inverse()});
  }
  sets = impl.candidate_sets(reference, target, last,
                             {impl.options.refine_template_px, impl.options.refine_min_score, true},
                             weak);
  result.timings.emplace_back("refine", watch.lap_ms());
  told = disambiguate(sets, rules, told.F);
  result.timings.emplace_back("check", watch.lap_ms());
  if (!told.F) return refuse("the matches do not agree on an epipolar geometry");
  const auto agreeing = static_cast<std::size_t>(
      std::count_if(sets.points.begin(), sets.points.end(),
                    [](const auto& point) { return point.accepted.has_value(); }));
  if (static_cast<double>(agreeing) < kMinShare * static_cast<double>(queries.size()))
    return refuse(fmt::format("only {} of {} points that should be in view were found", agreeing,
                              queries.size()));
  result.F = told.F;
  for (std::size_t i = 0; i < last.size(); ++i) {
    const MatchSets::Point& point = sets.points[i];
    const std::size_t k = last[i].point;
    if (point.accepted) {
      const SearchCandidate& candidate = point.candidates[*point.accepted];
      result.matches.push_back({k, reference.points[k], candidate.pixel, candidate.score,
                                candidate.covariance_px2, last[i].warp});
      unmatched[k].reset();
    } else if (point.last_withdrawn == Withdrawn::topology) {
      unmatched[k]->reason = NoMatch::topology;
    } else if (point.last_withdrawn != Withdrawn::nothing) {
      unmatched[k]->reason = NoMatch::geometry;
    }  // else the larger template found nothing
  }
  for (auto& entry : unmatched)
    if (entry) result.unmatched.push_back(std::move(*entry));
  return result;
}

}  // namespace corvid
