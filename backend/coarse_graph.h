#pragma once

#include <span>
#include <vector>

#include "backend/pose_graph.h"

namespace corvid {

/// Positions in a chain, ascending, at most `most` (at least 4) of them: first and last, those that
/// must be (as far as there is room), and others such that the strain between two is as small as it
/// can be.
/// @param strain  of each link of the chain, from i to i + 1; at least 1. A link with much of it
///                has a node at either end.
[[nodiscard]] std::vector<int> choose_nodes(std::span<const int> strain, std::span<const int> must,
                                            std::size_t most);

/// The graph of a chain of cameras with some of its nodes only: the others lie between the two
/// next to them, and what has to move moves them in proportion (a Galerkin projection of the normal
/// equations, linearised where the nodes are now). What ties two neighbours is exact for errors
/// that grow evenly between them; edges from farther away hold the nodes nearest to their ends.
///
/// Parallel edges become one. Of those that do not tie given nodes of `fine` to each other, each
/// node keeps the `most_across` strongest to earlier parts of the chain, so that the number of
/// edges is bounded as that of the nodes is. Unusable edges are passed over.
/// @param nodes  of choose_nodes(): positions in `fine`, which is in the order of the chain.
[[nodiscard]] PoseGraph coarsened(const PoseGraph& fine, const std::vector<int>& nodes,
                                  std::size_t most_across);

/// Moves every node of `fine` as those of `coarse` next to it have moved: the correction is
/// interpolated along a screw, so that no border shows.
void spread(const PoseGraph& coarse, const std::vector<int>& nodes, PoseGraph& fine);

}  // namespace corvid
