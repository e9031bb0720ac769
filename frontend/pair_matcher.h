#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/stopwatch.h"
#include "corvid/camera.h"
#include "corvid/error.h"
#include "corvid/image.h"
#include "corvid/options.h"
#include "frontend/disambiguate/disambiguate.h"
#include "frontend/disambiguate/match_sets.h"
#include "kernels/corners.h"
#include "kernels/ncc.h"
#include "kernels/pyramid.h"

namespace corvid {

class PairSearch;

/// One image made ready for matching: its pyramid, and the points that are looked for elsewhere
/// when it is the reference.
struct MatchView {
  Camera camera;
  std::shared_ptr<const DevicePyramid> pyramid;
  std::vector<Eigen::Vector2d> points;  ///< interest points, full resolution [px, distorted]
  /// Corners of the levels above 0, which lead the search down to them, full resolution [px].
  std::vector<std::vector<Eigen::Vector2d>> level_points;
};

/// A match of one interest point.
struct PairMatch {
  std::size_t point = 0;                                     ///< index into the reference's points
  Eigen::Vector2d x_r = Eigen::Vector2d::Zero(), x_t = x_r;  ///< [px, distorted]
  float score = 0;                                           ///< NCC
  /// Of x_t, from the shape of the correlation peak [px^2].
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Identity();
  Eigen::Matrix2d warp = Eigen::Matrix2d::Identity();  ///< offsets: target -> reference
};

/// Why an interest point has no match.
enum class NoMatch {
  no_candidate,  ///< no peak in its window, or its template leaves the image
  ambiguous,     ///< several candidates were left, and no module could tell
  geometry,      ///< against the epipolar geometry
  weak_corner,   ///< only candidates in flat image parts
  topology,      ///< against its neighbours
  low_score,     ///< was accepted, but the last measurement's larger template did not find it
};
struct UnmatchedPoint {
  std::size_t point = 0;
  NoMatch reason = NoMatch::no_candidate;
  /// Those that were left or, if there are none, those that were refused [px, distorted].
  std::vector<Eigen::Vector2d> candidates;
};

/// What matching two images gave.
struct PairMatches {
  std::vector<PairMatch> matches;         ///< ascending by point
  std::vector<UnmatchedPoint> unmatched;  ///< ascending by point; with matches: every point
  /// x_t^T F x_r = 0 on undistorted pixels (undistort_pixel()); nothing if the images do not show
  /// the same scene as far as can be told, and then there are no matches.
  std::optional<Eigen::Matrix3d> F;
  std::string refusal;  ///< why there is no geometry, for the user; else empty
  /// Modules' counts at full resolution: of the small windows, of the strips along epipolar lines,
  /// and of the last measurement, in that order; rounds are counted through.
  DisambiguationReport disambiguation;
  Timings timings;  ///< [ms] by step
};

/// A third image to which the reference was matched before.
struct AuxiliaryMatches {
  const MatchView* view = nullptr;
  /// Of each point of the reference, its match there [px, distorted], where there is one.
  std::vector<std::optional<Eigen::Vector2d>> x_a;
  Eigen::Matrix3d F_auxiliary_reference = Eigen::Matrix3d::Zero();  ///< x_a^T F x_r = 0
  std::optional<Eigen::Matrix3d> F_auxiliary_target;                ///< x_a^T F x_t = 0
};
/// From the matches of the same reference with that image.
[[nodiscard]] AuxiliaryMatches auxiliary_matches(const MatchView& reference,
                                                 const MatchView& auxiliary,
                                                 const PairMatches& matches);

/// From the matches of an earlier image with the reference (thesis 4.4.9, arrangement 1): what that
/// image's points came to lies beside the reference's own points, and is chained to them by
/// indirect_matches().
[[nodiscard]] AuxiliaryMatches prior_matches(const MatchView& prior, const MatchView& reference,
                                             const PairMatches& prior_to_reference,
                                             const DisambiguationOptions& options);

/// What is known before matching; everything may be missing.
struct PairKnowledge {
  /// From poses: the coarse search keeps to the epipolar lines.
  std::optional<Eigen::Matrix3d> F = {};
  std::span<const AuxiliaryMatches> auxiliary = {};
  bool upright = false;  ///< the images look alike as they stand: turns and scales are not tried
};

/// Matches two images by NCC (algorithms.md 3 and 4): from nothing (full search at a coarse level,
/// if need be over all turns and scales) or from known geometry; then level by level with
/// templates warped by the affinity of the neighbouring matches; candidates are told apart by
/// disambiguate().
///
/// Deterministic. One owner; not thread-safe. Throws DeviceFault.
class PairMatcher {
 public:
  [[nodiscard]] static Expected<std::unique_ptr<PairMatcher>> create(std::shared_ptr<Device> device,
                                                                     const MatchingOptions& options,
                                                                     Lane lane = Lane::tracking);
  ~PairMatcher();

  /// @param carried  points that shall be looked for whatever the corners are (tracks); they come
  ///                 first in MatchView::points, in their order. Corners keep away from them.
  [[nodiscard]] MatchView prepare(const GreyImage& image, const Camera& camera,
                                  std::span<const Eigen::Vector2d> carried = {});
  /// The same image with other points: as prepare() would give them.
  [[nodiscard]] MatchView carry(MatchView view, std::span<const Eigen::Vector2d> carried);
  [[nodiscard]] PairMatches match(const MatchView& reference, const MatchView& target,
                                  const PairKnowledge& known = {});

 private:
  class Run;
  explicit PairMatcher(std::unique_ptr<PairSearch> search);
  std::unique_ptr<PairSearch> search_;
};

}  // namespace corvid
