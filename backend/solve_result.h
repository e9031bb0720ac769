#pragma once

namespace corvid {

/// What a solve came to.
struct SolveResult {
  bool ok = false;       ///< the solver found finite values that are no worse
  bool stopped = false;  ///< asked to stop before it had converged; what was reached counts
  int iterations = 0;    ///< the start counts as one
  double initial_cost = 0, final_cost = 0;
};

}  // namespace corvid
