#pragma once

#include <Eigen/Core>

#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// Outliers of F go back from U to M and lose the match that they had (thesis 4.4.1).
ModuleCounts reject_epipolar_outliers(MatchSets& sets, const Eigen::Matrix3d& F,
                                      double max_distance_px);

/// Epipolar constraint (thesis 4.4.5): ratio_inequalities() on the Sampson distances of the
/// candidates of every point in M.
ModuleCounts accept_epipolar(MatchSets& sets, const Eigen::Matrix3d& F, double ratio,
                             double max_distance_px);

}  // namespace corvid
