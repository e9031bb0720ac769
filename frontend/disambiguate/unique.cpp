#include "frontend/disambiguate/unique.h"

namespace corvid {

ModuleCounts accept_unique(MatchSets& sets) {
  ModuleCounts counts;
  for (MatchSets::Point& point : sets.points) {
    if (!point.in_m()) continue;
    ++counts.in;
    if (point.candidates.size() != 1 || !(point.candidates[0].score > 0)) continue;
    point.accepted = 0;
    ++counts.accepted;
  }
  return counts;
}

}  // namespace corvid
