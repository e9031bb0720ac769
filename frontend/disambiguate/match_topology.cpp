#include "frontend/disambiguate/match_topology.h"

#include <algorithm>

namespace corvid {

ModuleCounts reject_topology(MatchSets& sets, const MatchedMesh& mesh, int max_common) {
  ModuleCounts counts;
  counts.in = static_cast<int>(mesh.points.size());
  const auto few = static_cast<std::size_t>(max_common);
  for (std::size_t i = 0; i < mesh.points.size(); ++i) {
    const auto near_r = mesh.reference.neighbours(i), near_t = mesh.target.neighbours(i);
    if (near_r.size() <= few || near_t.size() <= few) continue;
    const auto common = std::count_if(near_r.begin(), near_r.end(), [&](std::size_t neighbour) {
      return std::find(near_t.begin(), near_t.end(), neighbour) != near_t.end();
    });
    if (common > max_common) continue;
    MatchSets::Point& point = sets.points[mesh.points[i]];
    point.withdraw(*point.accepted, Withdrawn::topology);
    ++counts.rejected;
  }
  return counts;
}

}  // namespace corvid
