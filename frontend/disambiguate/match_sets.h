#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <vector>

#include "frontend/track_search.h"

namespace corvid {

/// What took the last candidate from a point.
enum class Withdrawn {
  nothing,   ///< no candidate was taken
  geometry,  ///< an accepted match was an outlier of F
  sectors,   ///< outside of the epipolar sector
  topology,  ///< an accepted match went against its neighbours
};

/// The state that the disambiguation modules work on (algorithms.md 4): every interest point of the
/// reference with its candidates in the target. A point with an accepted match is in U, a point
/// without one that still has candidates is in M.
struct MatchSets {
  struct Point {
    Eigen::Vector2d x_r;                      ///< undistorted, reference
    std::vector<SearchCandidate> candidates;  ///< best score first
    std::vector<Eigen::Vector2d> x_t;         ///< undistorted pixel of each candidate
    std::optional<std::size_t> accepted;      ///< index into candidates
    Withdrawn last_withdrawn = Withdrawn::nothing;
    std::vector<Eigen::Vector2d> refused;  ///< where candidates were that are not any more [px]

    [[nodiscard]] bool in_m() const { return !accepted && !candidates.empty(); }
    /// Of a point in U [undistorted px].
    [[nodiscard]] const Eigen::Vector2d& match() const { return x_t[*accepted]; }
    /// Takes a candidate away; the point leaves U if it was the accepted one.
    void withdraw(std::size_t k, Withdrawn reason) {
      refused.push_back(candidates[k].pixel);
      candidates.erase(candidates.begin() + static_cast<std::ptrdiff_t>(k));
      x_t.erase(x_t.begin() + static_cast<std::ptrdiff_t>(k));
      last_withdrawn = reason;
      if (accepted == k) {
        accepted.reset();
      } else if (accepted && *accepted > k) {
        --*accepted;
      }
    }
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
