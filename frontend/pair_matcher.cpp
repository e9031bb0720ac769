#include "frontend/pair_matcher.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/check.h"
#include "frontend/align.h"
#include "frontend/disambiguate/highest_scores.h"
#include "frontend/disambiguate/indirect_matches.h"
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
constexpr int kAlignIterations = 8;  // of Gauss-Newton, from the vertex; 4 lose 1 % of the matches
constexpr double kLeastRadiusPx = 4, kMostRadiusPx = 10;  // of a window, at its level
constexpr double kPiecePx = 24;                           // length of a strip's windows
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

/// Whether a template may be warped so: no mirroring, no large change of area.
bool usable(const Eigen::Matrix2d& linear) {
  const double area = linear.determinant();
  return area > 0.1 && area < 10;
}

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
                               const PairKnowledge& known, const Eigen::Matrix2d& prior,
                               std::size_t& asked);
  [[nodiscard]] Matched turned(const MatchView& reference, const MatchView& target, int level,
                               Eigen::Matrix2d& prior);
  /// The part of a point's epipolar line where its neighbours' depths would put it.
  [[nodiscard]] static std::vector<SearchWindow> strip(const MatchView& reference,
                                                       const MatchView& target,
                                                       const MotionField& field,
                                                       const LocalMotion& motion,
                                                       const Eigen::Matrix3d& F, std::size_t point);
  /// What disambiguate() needs to know of auxiliary images, for the points of the queries. The
  /// views refer to the arguments.
  [[nodiscard]] std::vector<AuxiliaryView> third_views(const MatchView& reference,
                                                       std::span<const Query> queries,
                                                       std::span<const AuxiliaryMatches> auxiliary);
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
  view = carry(std::move(view), carried);
  for (int level = 1; level < view.pyramid->levels(); ++level) {
    view.level_points.push_back(impl_->detect(*view.pyramid, level, kLevelPoints, {}));
    const DeviceImage& size = view.pyramid->level(level);
    if (std::max(size.width_px, size.height_px) <= kCoarseSidePx) break;
  }
  return view;
}

MatchView PairMatcher::carry(MatchView view, std::span<const Eigen::Vector2d> carried) {
  const auto corners = impl_->detect(*view.pyramid, 0, impl_->options.max_points, carried);
  view.points.assign(carried.begin(), carried.end());
  view.points.insert(view.points.end(), corners.begin(), corners.end());
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
  ncc_options.align_iterations = measure.exact ? kAlignIterations : 0;
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
                                                   const LocalMotion& motion,
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
    std::span<const AuxiliaryMatches> auxiliary) {
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

std::vector<float> PairMatcher::Impl::support(const MatchView& reference,
                                              const MatchView& auxiliary,
                                              std::span<const Query> queries,
                                              const MotionField& field,
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
  const double border_px = options.template_px / 2 + kAlongPx;
  std::vector<Query> asked;
  for (std::size_t i = 0; i < probes.size(); ++i) {
    Query query{queries[probes[i].point].point, {}, Eigen::Matrix2d::Identity()};
    const auto pixel = distorted(probes[i].place);
    if (usable(motions[i].linear) && pixel && auxiliary.camera.in_image(*pixel, border_px)) {
      const Eigen::Vector2d reach = kAlongPx * probes[i].line_direction;
      query.windows = strip_windows(auxiliary.camera, probes[i].place - reach,
                                    probes[i].place + reach, kAcrossPx, 8);
      query.warp = motions[i].linear.inverse();
    }
    asked.push_back(std::move(query));
  }
  const auto candidates = search(reference, auxiliary, reference.points, asked, 0,
                                 {options.template_px, options.min_score});
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

AuxiliaryMatches auxiliary_matches(const MatchView& reference, const MatchView& auxiliary,
                                   const PairMatches& matches) {
  AuxiliaryMatches third;
  third.view = &auxiliary;
  third.x_a.resize(reference.points.size());
  for (const PairMatch& match : matches.matches) third.x_a[match.point] = match.x_t;
  if (matches.F) third.F_auxiliary_reference = *matches.F;
  return third;
}

AuxiliaryMatches prior_matches(const MatchView& prior, const MatchView& reference,
                               const PairMatches& prior_to_reference,
                               const DisambiguationOptions& options) {
  std::vector<std::optional<Eigen::Vector2d>> points(reference.points.begin(),
                                                     reference.points.end());
  std::vector<Eigen::Vector2d> arrived, from;
  for (const PairMatch& match : prior_to_reference.matches) {
    arrived.push_back(match.x_t);
    from.push_back(match.x_r);
  }
  AuxiliaryMatches third;
  third.view = &prior;
  third.x_a = indirect_matches(points, arrived, from, options.ratio, options.global_px);
  if (prior_to_reference.F) third.F_auxiliary_reference = prior_to_reference.F->transpose();
  return third;
}

/// Matching one pair, step by step. A step that returns words has found that there is no geometry.
class PairMatcher::Run {
 public:
  Run(Impl& impl, const MatchView& reference, const MatchView& target, const PairKnowledge& known)
      : impl_(impl),
        reference_(reference),
        target_(target),
        known_(known),
        coarse_level_(std::min(static_cast<int>(reference.level_points.size()),
                               target.pyramid->levels() - 1)),
        weak_(reference.points.size(), false),
        reasons_(reference.points.size(), NoMatch::no_candidate),
        candidates_(reference.points.size()) {}

  [[nodiscard]] PairMatches match() {
    auto refusal = seed();
    if (!refusal) descend();
    if (!refusal) refusal = select();
    if (!refusal) refusal = measure();
    if (refusal) {
      result_.refusal = std::move(*refusal);
      result_.matches.clear();
      result_.F.reset();
    }
    std::vector<bool> matched(reference_.points.size(), false);
    for (const PairMatch& match : result_.matches) matched[match.point] = true;
    for (std::size_t k = 0; k < matched.size(); ++k)
      if (!matched[k]) result_.unmatched.push_back({k, reasons_[k], std::move(candidates_[k])});
    return std::move(result_);
  }

 private:
  using Refusal = std::optional<std::string>;
  static constexpr const char* kNoGeometry = "the matches do not agree on an epipolar geometry";

  /// From nothing: the whole coarse target, as it stands; if that gives little, turned and scaled.
  Refusal seed() {
    const auto& points = reference_.points;
    const int least = impl_.options.disambiguation.min_matches;
    if (points.size() < static_cast<std::size_t>(least))
      return fmt::format("the reference has {} interest points, fewer than {}", points.size(),
                         least);
    std::size_t asked = 0;
    matched_ = impl_.coarse(reference_, target_, coarse_level_, known_, prior_, asked);
    lap("coarse");
    if (matched_.from.size() < asked / 8) {
      Eigen::Matrix2d turn = prior_;
      Matched other = impl_.turned(reference_, target_, coarse_level_, turn);
      if (other.from.size() > 2 * matched_.from.size()) {
        matched_ = std::move(other);
        prior_ = turn;
      }
      lap("turned");
    }
    if (matched_.from.size() < kMinSeeds)
      return fmt::format("only {} features of the coarse images agree", matched_.from.size());
    return std::nullopt;
  }

  /// Down the pyramid, led by the neighbours.
  void descend() {
    for (int level = coarse_level_; level >= 1; --level) {
      const auto& points = reference_.level_points[static_cast<std::size_t>(level - 1)];
      const auto queries = guided(points, level);
      Matched next = keep_agreeing(impl_.unambiguous(reference_, target_, points, queries, level),
                                   prior_, 0.25, std::ldexp(1.5, level));
      if (next.from.size() >= kMinSeeds) matched_ = std::move(next);
      lap(fmt::format("level {}", level));
    }
  }

  /// Full resolution: small windows, which give the geometry; then what was not found is looked
  /// for along its epipolar line, and all is told apart again. Small templates are less exact than
  /// the last measurement, after which tau_f holds as it is.
  Refusal select() {
    DisambiguationOptions loose = impl_.options.disambiguation;
    loose.max_epipolar_px *= kSelectionSlack;
    const Measure small{impl_.options.template_px, impl_.options.min_score};
    queries_ = guided(reference_.points, 0);
    sets_ = impl_.candidate_sets(reference_, target_, queries_, small, weak_);
    lap("native");
    // Only F and what leads the strips is wanted of this pass: the modules that triangulate wait.
    DisambiguationOptions quick = loose;
    quick.sectors = quick.topology = false;
    bool told = tell_apart(quick, known_.F);
    lap("disambiguate");
    note_reasons();
    if (!told) return kNoGeometry;

    matched_ = accepted();
    const MotionField field(matched_.from, matched_.to, prior_);
    const Measure large{impl_.options.refine_template_px, impl_.options.min_score};
    std::vector<Query> strips;
    std::vector<std::size_t> slots;
    for (std::size_t i = 0; i < queries_.size(); ++i)
      if (!sets_.points[i].accepted) slots.push_back(i);
    std::vector<Eigen::Vector2d> places;
    for (std::size_t i : slots) places.push_back(reference_.points[queries_[i].point]);
    const auto motions = field.at(places);
    for (std::size_t k = 0; k < slots.size(); ++k) {
      Query& query = queries_[slots[k]];
      query.windows = impl_.strip(reference_, target_, field, motions[k], *result_.F, query.point);
      strips.push_back(query);
    }
    MatchSets more = impl_.candidate_sets(reference_, target_, strips, large, weak_);
    for (std::size_t k = 0; k < slots.size(); ++k) {
      MatchSets::Point& point = sets_.points[slots[k]];
      const Withdrawn before = point.last_withdrawn;
      point = std::move(more.points[k]);
      point.last_withdrawn = before;
    }
    lap("strips");
    told = tell_apart(loose, result_.F, impl_.third_views(reference_, queries_, known_.auxiliary));
    lap("disambiguate again");
    note_reasons();
    return told ? Refusal() : kNoGeometry;
  }

  /// What was accepted is measured once more, with larger templates and the warps that the matches
  /// give now: as accurate as it gets.
  Refusal measure() {
    const std::size_t in_view = queries_.size();
    matched_ = accepted();
    if (matched_.from.empty()) return "no match stood the disambiguation";
    const MotionField field(matched_.from, matched_.to, prior_);
    const auto motions = field.at(matched_.from);
    std::vector<Query> last;
    std::size_t next = 0;
    for (std::size_t i = 0; i < queries_.size(); ++i) {
      if (!sets_.points[i].accepted) continue;
      const LocalMotion& motion = motions[next];
      const Eigen::Vector2d& place = matched_.to[next++];
      reasons_[queries_[i].point] = NoMatch::low_score;  // unless it is found
      if (usable(motion.linear))
        last.push_back({queries_[i].point, {{place, 2, 2}}, motion.linear.inverse()});
    }
    queries_ = std::move(last);
    sets_ = impl_.candidate_sets(
        reference_, target_, queries_,
        {impl_.options.refine_template_px, impl_.options.refine_min_score, true}, weak_);
    lap("refine");
    const bool told = tell_apart(impl_.options.disambiguation, result_.F);
    lap("check");
    if (!told) return kNoGeometry;
    for (std::size_t i = 0; i < queries_.size(); ++i) {
      const MatchSets::Point& point = sets_.points[i];
      const std::size_t k = queries_[i].point;
      if (point.accepted) {
        const SearchCandidate& candidate = point.candidates[*point.accepted];
        result_.matches.push_back({k, reference_.points[k], candidate.pixel, candidate.score,
                                   candidate.covariance_px2, queries_[i].warp});
      } else if (point.last_withdrawn != Withdrawn::nothing) {
        reasons_[k] = reason_of(point.last_withdrawn);
      }
    }
    if (static_cast<double>(result_.matches.size()) < kMinShare * static_cast<double>(in_view))
      return fmt::format("only {} of {} points that should be in view were found",
                         result_.matches.size(), in_view);
    return std::nullopt;
  }

  /// Windows around where the neighbours went, of the points whose place is in the target.
  [[nodiscard]] std::vector<Query> guided(std::span<const Eigen::Vector2d> points,
                                          int level) const {
    const MotionField field(matched_.from, matched_.to, prior_);
    const auto motions = field.at(points);
    std::vector<Query> queries;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const LocalMotion& motion = motions[i];
      if (!usable(motion.linear) || !target_.camera.in_image(motion.x_t)) continue;
      const double radius_px = std::ldexp(
          std::clamp(3 * std::ldexp(motion.spread_px, -level), kLeastRadiusPx, kMostRadiusPx),
          level);
      queries.push_back({i, {{motion.x_t, radius_px, radius_px}}, motion.linear.inverse()});
    }
    return queries;
  }

  /// disambiguate() on the sets; its counts are added to the others'. Whether there is an F.
  bool tell_apart(const DisambiguationOptions& rules, const std::optional<Eigen::Matrix3d>& F,
                  std::span<const AuxiliaryView> third = {}) {
    Disambiguation told = disambiguate(sets_, rules, F, third);
    DisambiguationReport& report = result_.disambiguation;
    for (ModuleRun& run : told.report.runs) {
      run.round += report.rounds;
      report.runs.push_back(run);
    }
    report.rounds += told.report.rounds;
    result_.F = told.F;
    return told.F.has_value();
  }

  [[nodiscard]] Matched accepted() const {
    Matched found;
    for (std::size_t i = 0; i < queries_.size(); ++i)
      if (const auto& point = sets_.points[i]; point.accepted)
        found.add(reference_.points[queries_[i].point], point.candidates[*point.accepted].pixel);
    return found;
  }

  [[nodiscard]] static NoMatch reason_of(Withdrawn withdrawn) {
    return withdrawn == Withdrawn::topology ? NoMatch::topology : NoMatch::geometry;
  }

  void note_reasons() {
    for (std::size_t i = 0; i < queries_.size(); ++i) {
      const MatchSets::Point& point = sets_.points[i];
      const std::size_t k = queries_[i].point;
      candidates_[k].clear();
      for (const SearchCandidate& candidate : point.candidates)
        candidates_[k].push_back(candidate.pixel);
      if (!point.candidates.empty())
        reasons_[k] = NoMatch::ambiguous;
      else if (point.last_withdrawn != Withdrawn::nothing)
        reasons_[k] = reason_of(point.last_withdrawn);
      else
        reasons_[k] = weak_[k] ? NoMatch::weak_corner : NoMatch::no_candidate;
    }
  }

  void lap(std::string step) { result_.timings.emplace_back(std::move(step), watch_.lap_ms()); }

  Impl& impl_;
  const MatchView& reference_;
  const MatchView& target_;
  const PairKnowledge& known_;
  const int coarse_level_;
  Eigen::Matrix2d prior_ = Eigen::Matrix2d::Identity();
  Matched matched_;             ///< what leads the next step
  std::vector<Query> queries_;  ///< of the full resolution
  MatchSets sets_;              ///< one point per query
  std::vector<bool> weak_;
  std::vector<NoMatch> reasons_;
  std::vector<std::vector<Eigen::Vector2d>> candidates_;
  PairMatches result_;
  Stopwatch watch_;
};

PairMatches PairMatcher::match(const MatchView& reference, const MatchView& target,
                               const PairKnowledge& known) {
  return Run(*impl_, reference, target, known).match();
}

}  // namespace corvid
