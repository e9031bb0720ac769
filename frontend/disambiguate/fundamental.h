#pragma once

#include <Eigen/Core>
#include <optional>

#include "corvid/options.h"
#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// The probability that a wrong candidate agrees with F within max_distance_px by chance: from the
/// density of the candidates that do not agree, but at least what candidates spread evenly over
/// the part of the target in which there are any would give. In [0, 1].
[[nodiscard]] double chance_of_agreement(const MatchSets& sets, const Eigen::Matrix3d& F,
                                         double max_distance_px);

/// Whether `agreeing` of `points` matches on one F are clearly more than the best of all F would
/// find by chance, each match agreeing with probability `chance`: the number of false alarms
/// (Moisan and Stival, A probabilistic criterion to detect rigid point matches between two images,
/// IJCV 2004; here with samples of 8) is below 1e-6.
[[nodiscard]] bool beyond_chance(int agreeing, int points, double chance);

/// Fundamental matrix over U (thesis 4.4.2): from F, if it is given and most of U agrees with it,
/// else by RANSAC; refined over U; its outliers go back to M and lose their match.
///
/// @param[in,out] F  out: nothing, and U as it was, if fewer than options.min_matches agree, or no
///                   more than chance gives.
ModuleCounts fit_fundamental(MatchSets& sets, const DisambiguationOptions& options,
                             std::optional<Eigen::Matrix3d>& F);

}  // namespace corvid
