#pragma once

#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// Preliminary matches (thesis 4.4.1): points with exactly one candidate, of a positive score.
/// To be run once, before candidates are withdrawn: a candidate that is left over when others were
/// refused is no preliminary match.
ModuleCounts accept_unique(MatchSets& sets);

}  // namespace corvid
