#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "kernels/ncc.h"
#include "kernels/pyramid.h"

namespace corvid {

/// A feature to be found again: where its template was cut, how it is warped, where it may be now.
struct SearchQuery {
  std::shared_ptr<const DevicePyramid> anchor;             ///< frame of the template
  Eigen::Vector2d anchor_px = Eigen::Vector2d::Zero();     ///< template centre in it
  Eigen::Matrix2d warp = Eigen::Matrix2d::Identity();      ///< target offset -> anchor offset
  Eigen::Vector2d predicted_px = Eigen::Vector2d::Zero();  ///< in the target
};

/// One possible place of a feature.
struct SearchCandidate {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  float score = 0;
  /// From the shape of the correlation peak, see peak_covariance_px2().
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Identity();
};

/// Covariance of a peak's position against the template [px^2 of its image]: (1 - C) / (2 |H|)
/// along each of the axes of the peak's Hessian H, C the score, standard deviations within 0.1 and
/// 4 px.
///
/// Least squares on a residual of independent noise, whose mean square is 2 (1 - C) where the
/// signals have variance 1, give 2 (1 - C) / (N |H|) with N samples. What is left between two views
/// is not independent: shape, resampling and light differ over whole parts of the template. The
/// factor N / 4 stands for that; with it squared errors on rendered flights are about as large as
/// they should be (tests/frontend/covariance_test.cpp).
[[nodiscard]] Eigen::Matrix2d peak_covariance_px2(const NccPeak& peak);

/// A peak found in a pyramid level, in units of the full resolution.
[[nodiscard]] SearchCandidate to_candidate(const NccPeak& peak, int level);

/// Coarse to fine: which pyramid level first, how far around the prediction [px of that level], and
/// how far at each finer level.
struct SearchSchedule {
  int first_level = 2;
  int first_radius_px = 4;
  int refine_radius_px = 3;
};

/// NCC search of many features in one image (algorithms.md 3, "in a video stream").
class TrackSearch {
 public:
  TrackSearch(NccMatcher& matcher, int template_px, double peak_quality)
      : matcher_(matcher), template_px_(template_px), peak_quality_(peak_quality) {}

  /// The place of each query at full resolution; score 0 where there is none. Where a template
  /// does not fit into a coarse level, the search starts at a finer one with a wider window.
  [[nodiscard]] std::vector<SearchCandidate> track(const DevicePyramid& target,
                                                   std::span<const SearchQuery> queries,
                                                   const SearchSchedule& schedule);

  /// All candidates of each query at one level, best first (Q_m pruning), pixels in units of the
  /// full resolution.
  [[nodiscard]] std::vector<std::vector<SearchCandidate>> candidates(
      const DevicePyramid& target, std::span<const SearchQuery> queries, int level, int radius_px);

 private:
  struct LevelJob {
    std::size_t query = 0;
    Eigen::Vector2d predicted_px;  ///< full resolution
    int radius_px = 0;             ///< of the level
  };
  [[nodiscard]] std::vector<NccResult> match_level(const DevicePyramid& target,
                                                   std::span<const SearchQuery> queries,
                                                   std::span<const LevelJob> jobs, int level,
                                                   double peak_quality);

  NccMatcher& matcher_;
  int template_px_;
  double peak_quality_;
};

}  // namespace corvid
