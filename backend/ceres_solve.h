#pragma once

#include <ceres/problem.h>
#include <ceres/solver.h>

#include "backend/solve_result.h"

namespace corvid {

/// What every solve here agrees on: Eigen's sparse solvers, and silence.
[[nodiscard]] ceres::Solver::Options solver_options(int max_iterations, double cost_tolerance,
                                                    int threads);

/// Solves; `ok` says that the solution is usable and no worse than the start. That the values are
/// finite is for the caller to see.
///
/// Ceres warns through glog, which writes to stderr until a program sets it up: the solver's
/// troubles come back in the result, and the library prints nothing.
[[nodiscard]] SolveResult solve(const ceres::Solver::Options& options, ceres::Problem& problem);

}  // namespace corvid
