#pragma once

#include <Eigen/Core>

#include "frontend/disambiguate/match_sets.h"
#include "frontend/disambiguate/matched_mesh.h"

namespace corvid {

/// Epipolar sectors (thesis 4.4.6): in the Delaunay triangulation of U in the reference, the
/// epipolar lines of the corners of the triangle that holds a point of M bound a sector of the
/// target; candidates outside of it are withdrawn. The denser the matches, the narrower the sector.
///
/// A sector is only one side of the epipole, that on which the matches of U lie (oriented epipolar
/// geometry), where nine tenths of U agree on it. A candidate is never called outside of the lines
/// if it agrees with the point's own line within max_distance_px. Points outside of all triangles
/// are left alone, and where the triangle holds the epipole every line is inside.
///
/// @param mesh  of U as it is.
/// @return counts.rejected: candidates withdrawn.
ModuleCounts reject_outside_sectors(MatchSets& sets, MatchedMesh& mesh, const Eigen::Matrix3d& F,
                                    double max_distance_px);

}  // namespace corvid
