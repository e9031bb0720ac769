#pragma once

#include <Eigen/Core>

#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// Outliers of F go back from U to M and lose the match that they had (thesis 4.4.1).
ModuleCounts reject_epipolar_outliers(MatchSets& sets, const Eigen::Matrix3d& F,
                                      double max_distance_px);

/// Epipolar constraint (thesis 4.4.4): the ratio-inequalities test on the Sampson distances of a
/// point's candidates: the nearest, d1, is accepted if d1 < global and the second, d2, is over
/// `ratio` times as far and beyond `global`; a candidate that is alone needs d1 < global only.
ModuleCounts accept_epipolar(MatchSets& sets, const Eigen::Matrix3d& F, double ratio,
                             double max_distance_px);

}  // namespace corvid
