#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "frontend/track_search.h"

namespace corvid {

/// The state that the disambiguation modules work on (algorithms.md 4): every interest point of the
/// reference with its candidates in the target. A point with an accepted match is in U, a point
/// without one that still has candidates is in M.
struct MatchSets {
  struct Point {
    Eigen::Vector2d x_r;                      ///< undistorted, reference
    std::vector<SearchCandidate> candidates;  ///< best score first
    std::vector<Eigen::Vector2d> x_t;         ///< undistorted pixel of each candidate
    std::optional<std::size_t> accepted;      ///< index into candidates
  };
  std::vector<Point> points;
};

/// What a module did.
struct ModuleCounts {
  int in = 0;        ///< points looked at
  int accepted = 0;  ///< points that entered U
  int rejected = 0;  ///< points thrown out of U, or candidates withdrawn
};

}  // namespace corvid
