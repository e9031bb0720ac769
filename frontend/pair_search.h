#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "corvid/error.h"
#include "corvid/options.h"
#include "frontend/disambiguate/disambiguate.h"
#include "frontend/disambiguate/match_sets.h"
#include "frontend/epipolar_strip.h"
#include "frontend/motion_field.h"
#include "frontend/pair_matcher.h"
#include "frontend/track_search.h"
#include "kernels/corners.h"
#include "kernels/ncc.h"
#include "kernels/pyramid.h"

namespace corvid {

/// Where a template is looked for, and how it is warped (target offsets to reference offsets).
struct PairQuery {
  std::size_t point = 0;              ///< in the list of points
  std::vector<SearchWindow> windows;  ///< full resolution
  Eigen::Matrix2d warp = Eigen::Matrix2d::Identity();
};

/// With what is searched, and what counts.
struct PairMeasure {
  int template_px = 11;
  double min_score = 0;
  bool exact = false;  ///< peaks are aligned on the images; else the quadratic's vertex will do
};

/// Points of the reference and where they are in the target, full resolution [px, distorted].
struct PairPlaces {
  std::vector<Eigen::Vector2d> from, to;
  void add(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    from.push_back(a);
    to.push_back(b);
  }
};

/// Whether a template may be warped so: no mirroring, no large change of area.
[[nodiscard]] bool usable_warp(const Eigen::Matrix2d& linear);

/// Drops the matches whose neighbours moved otherwise, twice: the wrong ones spoil the first round.
[[nodiscard]] PairPlaces keep_agreeing(PairPlaces matched, const Eigen::Matrix2d& prior,
                                       double share, double slack_px);

/// The searches that matching a pair is made of (PairMatcher puts them in order). Pixels are of
/// the full resolution, distorted, whatever the level of the pyramid.
///
/// Deterministic. One owner; not thread-safe. Throws DeviceFault.
class PairSearch {
 public:
  [[nodiscard]] static Expected<std::unique_ptr<PairSearch>> create(std::shared_ptr<Device> device,
                                                                    const MatchingOptions& options,
                                                                    Lane lane);
  [[nodiscard]] const MatchingOptions& options() const { return options_; }

  [[nodiscard]] std::shared_ptr<const DevicePyramid> pyramid(const GreyImage& image, int levels);
  [[nodiscard]] std::vector<Eigen::Vector2d> detect(const DevicePyramid& pyramid, int level,
                                                    int most,
                                                    std::span<const Eigen::Vector2d> occupied);
  /// The best candidate of each point where there is no other nearly as good.
  [[nodiscard]] PairPlaces unambiguous(const MatchView& reference, const MatchView& target,
                                       std::span<const Eigen::Vector2d> points,
                                       std::span<const PairQuery> queries, int level);
  /// Search of some corners of a level in the whole target, or along their epipolar lines if F is
  /// known: those that agree with their neighbours. `asked` is how many were looked for.
  [[nodiscard]] PairPlaces coarse(const MatchView& reference, const MatchView& target, int level,
                                  const PairKnowledge& known, const Eigen::Matrix2d& prior,
                                  std::size_t& asked);
  /// The same after the images were turned and scaled onto each other, by `prior`.
  [[nodiscard]] PairPlaces turned(const MatchView& reference, const MatchView& target, int level,
                                  Eigen::Matrix2d& prior);
  /// The part of a point's epipolar line where its neighbours' depths would put it.
  [[nodiscard]] static std::vector<SearchWindow> strip(const MatchView& reference,
                                                       const MatchView& target,
                                                       const MotionField& field,
                                                       const LocalMotion& motion,
                                                       const Eigen::Matrix3d& F, std::size_t point);
  /// Candidates of the queries at full resolution, weak corners removed (`weak` of their points is
  /// set), ready for disambiguate().
  [[nodiscard]] MatchSets candidate_sets(const MatchView& reference, const MatchView& target,
                                         std::span<const PairQuery> queries,
                                         const PairMeasure& measure, std::vector<bool>& weak);
  /// What disambiguate() needs to know of auxiliary images, for the points of the queries. The
  /// views refer to the arguments.
  [[nodiscard]] std::vector<AuxiliaryView> third_views(const MatchView& reference,
                                                       std::span<const PairQuery> queries,
                                                       std::span<const AuxiliaryMatches> auxiliary);

 private:
  PairSearch(const MatchingOptions& options, Lane lane, PyramidBuilder pyramids,
             CornerDetector corners, NccMatcher ncc)
      : options_(options),
        lane_(lane),
        pyramids_(std::move(pyramids)),
        corners_(std::move(corners)),
        ncc_(std::move(ncc)) {}

  /// Candidates of each query, best first.
  [[nodiscard]] std::vector<std::vector<SearchCandidate>> search(
      const MatchView& reference, const MatchView& target, std::span<const Eigen::Vector2d> points,
      std::span<const PairQuery> queries, int level, const PairMeasure& measure);
  /// AuxiliaryView::support.
  [[nodiscard]] std::vector<float> support(const MatchView& reference, const MatchView& auxiliary,
                                           std::span<const PairQuery> queries,
                                           const MotionField& field,
                                           std::span<const AuxiliaryView::Probe> probes);

  MatchingOptions options_;
  Lane lane_;
  PyramidBuilder pyramids_;
  CornerDetector corners_;
  NccMatcher ncc_;
};

}  // namespace corvid
