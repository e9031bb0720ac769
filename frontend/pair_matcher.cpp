#include "frontend/pair_matcher.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "frontend/disambiguate/indirect_matches.h"
#include "frontend/motion_field.h"
#include "frontend/pair_search.h"

namespace corvid {
namespace {

constexpr int kMinSidePx = 48;      // of the smallest pyramid level
constexpr int kCoarseSidePx = 320;  // widest side of the level that is searched in full
constexpr int kLevelPoints = 2000;  // templates of each level between it and the full resolution
constexpr int kMinSeeds = 12;       // matches of the coarse level that agree
constexpr double kSelectionSlack = 2.5;  // on tau_f, until the last measurement
// Of the points that should be in view. True pairs: 0.3 and more; views of other parts of a scene
// with the same kinds of texture: up to 0.05.
constexpr double kMinShare = 0.08;
constexpr double kLeastRadiusPx = 4, kMostRadiusPx = 10;  // of a window, at its level

}  // namespace

PairMatcher::PairMatcher(std::unique_ptr<PairSearch> search) : search_(std::move(search)) {}
PairMatcher::~PairMatcher() = default;

Expected<std::unique_ptr<PairMatcher>> PairMatcher::create(std::shared_ptr<Device> device,
                                                           const MatchingOptions& options,
                                                           Lane lane) {
  auto search = PairSearch::create(std::move(device), options, lane);
  if (!search) return tl::unexpected(search.error());
  return std::unique_ptr<PairMatcher>(new PairMatcher(std::move(*search)));
}

MatchView PairMatcher::prepare(const GreyImage& image, const Camera& camera,
                               std::span<const Eigen::Vector2d> carried) {
  int levels = 1;
  while ((std::min(image.width(), image.height()) >> levels) >= kMinSidePx) ++levels;
  MatchView view;
  view.camera = camera;
  view.pyramid = search_->pyramid(image, levels);
  view = carry(std::move(view), carried);
  for (int level = 1; level < view.pyramid->levels(); ++level) {
    view.level_points.push_back(search_->detect(*view.pyramid, level, kLevelPoints, {}));
    const DeviceImage& size = view.pyramid->level(level);
    if (std::max(size.width_px, size.height_px) <= kCoarseSidePx) break;
  }
  return view;
}

MatchView PairMatcher::carry(MatchView view, std::span<const Eigen::Vector2d> carried) {
  const auto corners = search_->detect(*view.pyramid, 0, search_->options().max_points, carried);
  view.points.assign(carried.begin(), carried.end());
  view.points.insert(view.points.end(), corners.begin(), corners.end());
  return view;
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
  Run(PairSearch& search, const MatchView& reference, const MatchView& target,
      const PairKnowledge& known)
      : search_(search),
        options_(search.options()),
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
    const int least = options_.disambiguation.min_matches;
    if (points.size() < static_cast<std::size_t>(least))
      return fmt::format("the reference has {} interest points, fewer than {}", points.size(),
                         least);
    std::size_t asked = 0;
    matched_ = search_.coarse(reference_, target_, coarse_level_, known_, prior_, asked);
    lap("coarse");
    if (matched_.from.size() < asked / 8 && !known_.upright) {
      Eigen::Matrix2d turn = prior_;
      PairPlaces other = search_.turned(reference_, target_, coarse_level_, turn);
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
      PairPlaces next =
          keep_agreeing(search_.unambiguous(reference_, target_, points, queries, level), prior_,
                        0.25, std::ldexp(1.5, level));
      if (next.from.size() >= kMinSeeds) matched_ = std::move(next);
      lap(fmt::format("level {}", level));
    }
  }

  /// Full resolution: small windows, which give the geometry; then what was not found is looked
  /// for along its epipolar line, and all is told apart again. Small templates are less exact than
  /// the last measurement, after which tau_f holds as it is.
  Refusal select() {
    DisambiguationOptions loose = options_.disambiguation;
    loose.max_epipolar_px *= kSelectionSlack;
    const PairMeasure small{options_.template_px, options_.min_score};
    queries_ = guided(reference_.points, 0);
    sets_ = search_.candidate_sets(reference_, target_, queries_, small, weak_);
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
    const PairMeasure large{options_.refine_template_px, options_.min_score};
    std::vector<PairQuery> strips;
    std::vector<std::size_t> slots;
    for (std::size_t i = 0; i < queries_.size(); ++i)
      if (!sets_.points[i].accepted) slots.push_back(i);
    std::vector<Eigen::Vector2d> places;
    for (std::size_t i : slots) places.push_back(reference_.points[queries_[i].point]);
    const auto motions = field.at(places);
    for (std::size_t k = 0; k < slots.size(); ++k) {
      PairQuery& query = queries_[slots[k]];
      query.windows =
          search_.strip(reference_, target_, field, motions[k], *result_.F, query.point);
      strips.push_back(query);
    }
    MatchSets more = search_.candidate_sets(reference_, target_, strips, large, weak_);
    for (std::size_t k = 0; k < slots.size(); ++k) {
      MatchSets::Point& point = sets_.points[slots[k]];
      MatchSets::Point before = std::exchange(point, std::move(more.points[k]));
      point.last_withdrawn = before.last_withdrawn;
      point.refused.insert(point.refused.end(), before.refused.begin(), before.refused.end());
    }
    lap("strips");
    told =
        tell_apart(loose, result_.F, search_.third_views(reference_, queries_, known_.auxiliary));
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
    std::vector<PairQuery> last;
    std::size_t next = 0;
    for (std::size_t i = 0; i < queries_.size(); ++i) {
      if (!sets_.points[i].accepted) continue;
      const LocalMotion& motion = motions[next];
      const Eigen::Vector2d& place = matched_.to[next++];
      reasons_[queries_[i].point] = NoMatch::low_score;  // unless it is found
      if (usable_warp(motion.linear))
        last.push_back({queries_[i].point, {{place, 2, 2}}, motion.linear.inverse()});
    }
    queries_ = std::move(last);
    sets_ = search_.candidate_sets(reference_, target_, queries_,
                                   {options_.refine_template_px, options_.refine_min_score, true},
                                   weak_);
    lap("refine");
    const bool told = tell_apart(options_.disambiguation, result_.F);
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
  [[nodiscard]] std::vector<PairQuery> guided(std::span<const Eigen::Vector2d> points,
                                              int level) const {
    const MotionField field(matched_.from, matched_.to, prior_);
    const auto motions = field.at(points);
    std::vector<PairQuery> queries;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const LocalMotion& motion = motions[i];
      if (!usable_warp(motion.linear) || !target_.camera.in_image(motion.x_t)) continue;
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

  [[nodiscard]] PairPlaces accepted() const {
    PairPlaces found;
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
      if (point.candidates.empty()) candidates_[k] = point.refused;
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

  PairSearch& search_;
  const MatchingOptions& options_;
  const MatchView& reference_;
  const MatchView& target_;
  const PairKnowledge& known_;
  const int coarse_level_;
  Eigen::Matrix2d prior_ = Eigen::Matrix2d::Identity();
  PairPlaces matched_;              ///< what leads the next step
  std::vector<PairQuery> queries_;  ///< of the full resolution
  MatchSets sets_;                  ///< one point per query
  std::vector<bool> weak_;
  std::vector<NoMatch> reasons_;
  std::vector<std::vector<Eigen::Vector2d>> candidates_;
  PairMatches result_;
  Stopwatch watch_;
};

PairMatches PairMatcher::match(const MatchView& reference, const MatchView& target,
                               const PairKnowledge& known) {
  return Run(*search_, reference, target, known).match();
}

}  // namespace corvid