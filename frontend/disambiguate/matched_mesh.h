#pragma once

#include <cstddef>
#include <vector>

#include "frontend/disambiguate/delaunay.h"
#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// The Delaunay triangulations of the matches of U in both images, made in parallel.
struct MatchedMesh {
  explicit MatchedMesh(const MatchSets& sets);

  std::vector<std::size_t> points;  ///< of MatchSets: vertex i of both is points[i]
  Delaunay reference, target;
};

}  // namespace corvid
