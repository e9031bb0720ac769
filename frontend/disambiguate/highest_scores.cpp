#include "frontend/disambiguate/highest_scores.h"

namespace corvid {

ModuleCounts accept_highest_scores(MatchSets& sets, double ratio) {
  ModuleCounts counts;
  for (MatchSets::Point& point : sets.points) {
    if (point.accepted || point.candidates.size() < 2) continue;
    ++counts.in;
    if (!(point.candidates[0].score > ratio * point.candidates[1].score)) continue;
    point.accepted = 0;
    ++counts.accepted;
  }
  return counts;
}

}  // namespace corvid
