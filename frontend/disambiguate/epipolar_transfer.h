#pragma once

#include <Eigen/Core>
#include <optional>

#include "corvid/options.h"
#include "frontend/disambiguate/disambiguate.h"
#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// The crossing of two lines of an image (4.34) and how well it is known.
struct LineCrossing {
  Eigen::Vector2d place;      ///< [px]
  Eigen::Vector2d direction;  ///< unit, along the first line
  double sine = 0;            ///< of the angle between the lines
};
/// Nothing where the lines are parallel to 1e-6 rad, or one is no line.
[[nodiscard]] std::optional<LineCrossing> cross_lines(const Eigen::Vector3d& first,
                                                      const Eigen::Vector3d& second);

/// Epipolar transfer (thesis 4.4.11): the candidates of a point of M that agree with F within
/// max_epipolar_px are moved onto F exactly (correct_match()) and transferred to the auxiliary view
/// as the crossing of the epipolar lines of both ends. A candidate is supported if the reference's
/// template has a peak there (AuxiliaryView::support) whose score is at least
/// AuxiliaryView::peak_quality of the best among the point's candidates and their transfers; it is
/// accepted if it is the only one. Near the trifocal plane, where the crossing is not known to
/// within the window of the search, a point is left alone.
///
/// One call of AuxiliaryView::support. F between the auxiliary view and the target is estimated
/// from the points of U that have a match in the auxiliary view, if it is not known; without it, or
/// without a support function, nothing is done.
ModuleCounts accept_epipolar_transfer(MatchSets& sets, const Eigen::Matrix3d& F,
                                      const AuxiliaryView& auxiliary,
                                      const DisambiguationOptions& options);

}  // namespace corvid
