#pragma once

#include <cstddef>
#include <vector>

#include "backend/map_data.h"
#include "backend/pose_graph.h"
#include "backend/start.h"

namespace corvid {

/// Nodes of the largest pose graph that is solved: longer chains of keyframes are coarsened. What a
/// closed loop costs does not grow with the flight: docs/decisions/places.md.
constexpr std::size_t kMostLoopNodes = 400;

/// A loop's pose graph: the keyframes of one segment, what ties them, and the loop.
struct LoopGraph {
  std::vector<int> keyframes;  ///< of each node of `fine`, ascending
  PoseGraph fine;
  std::vector<int> nodes;  ///< positions in `fine` that are to be solved for; all of a short chain
};

/// Each keyframe of the query's segment and the six that share the most landmarks with it. Of a
/// chain of more than `most_nodes`, some keyframes are asked for those, and stand for the others.
/// @param T_world_query  where the query shall be, its scale that of the old map per its own unit.
[[nodiscard]] LoopGraph loop_graph(const MapData& map, int query, int reference,
                                   const Sim3& T_world_query, std::size_t most_nodes);

/// Carries a loop's correction round: pose graph over the segment of the query.
/// @return false, and nothing is changed, if the graph cannot be solved.
bool bend_loop(MapData& map, std::vector<FrameRecord>& frames, int query, int reference,
               const Sim3& T_world_query, int threads, std::size_t most_nodes = kMostLoopNodes);

}  // namespace corvid
