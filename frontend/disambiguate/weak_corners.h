#pragma once

#include <Eigen/Core>

namespace corvid {

/// Whether a corner score can be had at a point: nearer to the border, CornerDetector::score_at()
/// gives 0, which says nothing of the image.
[[nodiscard]] bool has_corner_score(const Eigen::Vector2f& point, int width_px, int height_px);

/// Weak-corner removal (thesis 4.3): whether a candidate with corner score `score_t` at `point` is
/// too weak to be the corner that a template of score `score_r` was cut from. A candidate without
/// any texture (score 0) is; one whose score is not known is not.
[[nodiscard]] bool is_weak_corner(float score_r, float score_t, const Eigen::Vector2f& point,
                                  int width_px, int height_px, double ratio);

}  // namespace corvid
