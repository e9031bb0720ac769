#pragma once

#include <Eigen/Core>
#include <span>
#include <string_view>

#include "corvid/pose.h"

namespace corvid {

enum class AlignmentStatus {
  ok,
  too_few,     ///< fewer than three points, or the two sets differ in size
  not_finite,  ///< a coordinate is NaN or infinite
  degenerate,  ///< all points on one line, or in one place: the rotation is not unique
};
[[nodiscard]] std::string_view to_string(AlignmentStatus status);

struct PointAlignment {
  AlignmentStatus status = AlignmentStatus::too_few;
  Sim3 T_target_source;  ///< identity unless ok; scale 1 if no scale was asked for
  double rmse = 0;       ///< of what remains [units of target]
  [[nodiscard]] bool ok() const { return status == AlignmentStatus::ok; }
};

/// Similarity (or rigid motion) that takes `source[i]` nearest to `target[i]`, in least squares.
///
/// Closed form: Umeyama, "Least-squares estimation of transformation parameters between two point
/// patterns", PAMI 1991, eqs. 40 to 43. Never a reflection. O(N).
[[nodiscard]] PointAlignment align_points(std::span<const Eigen::Vector3d> source,
                                          std::span<const Eigen::Vector3d> target, bool with_scale);

}  // namespace corvid
