#pragma once

#include "frontend/disambiguate/match_sets.h"
#include "frontend/disambiguate/matched_mesh.h"

namespace corvid {

/// Match topology (thesis 4.4.10): a match of which at most `max_common` Delaunay neighbours in the
/// reference are also neighbours in the target is withdrawn. A match that has no more neighbours
/// than that in one of the images is not judged.
///
/// @param mesh  of U as it is: all are judged by it.
ModuleCounts reject_topology(MatchSets& sets, const MatchedMesh& mesh, int max_common);

}  // namespace corvid
