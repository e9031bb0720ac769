#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "frontend/track_search.h"
#include "kernels/corners.h"
#include "kernels/pyramid.h"

namespace corvid {

/// Whether a corner score can be had at a point: nearer to the border, CornerDetector::score_at()
/// gives 0, which says nothing of the image.
[[nodiscard]] bool has_corner_score(const Eigen::Vector2f& point, int width_px, int height_px);

/// Weak-corner removal (thesis 4.3): whether a candidate with corner score `score_t` at `point` is
/// too weak to be the corner that a template of score `score_r` was cut from. A candidate without
/// any texture (score 0) is; one whose score is not known is not.
[[nodiscard]] bool is_weak_corner(float score_r, float score_t, const Eigen::Vector2f& point,
                                  int width_px, int height_px, double ratio);

/// Weak-corner removal between two images: takes the weak ones out of the candidates of `points`
/// and returns them, by point. Corner scores go with the square of the exposure, so they are
/// compared after the typical ratio, the median over the points' best candidates.
///
/// @param reference,target  the images at one level of their pyramids
/// @param points            whose templates were searched; like the candidates' places, full
///                          resolution [px]
/// @param kappa,ratio       of the Harris-Stephens score; tau_c
/// @param lane              of the corner scores
[[nodiscard]] std::vector<std::vector<SearchCandidate>> take_weak_corners(
    CornerDetector& corners, const DeviceImage& reference, const DeviceImage& target, int level,
    std::span<const Eigen::Vector2d> points, double kappa, double ratio,
    std::vector<std::vector<SearchCandidate>>& candidates, Lane lane);

}  // namespace corvid
