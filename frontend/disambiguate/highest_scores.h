#pragma once

#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// Highest scores (thesis 4.4.4): accepts the best candidate of every point in M whose score over
/// the second's exceeds `ratio` (tau_hsr). A candidate that is alone has nothing to be compared
/// with: accept_unique() or the geometry decides.
ModuleCounts accept_highest_scores(MatchSets& sets, double ratio);

}  // namespace corvid
