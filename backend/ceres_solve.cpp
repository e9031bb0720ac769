#include "backend/ceres_solve.h"

#include <glog/logging.h>

#include <algorithm>

namespace corvid {
namespace {

void silence_glog() {
  static const bool done = [] {
    if (!google::IsGoogleLoggingInitialized()) FLAGS_minloglevel = google::GLOG_FATAL;
    return true;
  }();
  (void)done;
}

}  // namespace

ceres::Solver::Options solver_options(int max_iterations, double cost_tolerance, int threads) {
  ceres::Solver::Options options;
  // Eigen: Debian's SuiteSparse has parts under the GPL.
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  options.max_num_iterations = max_iterations;
  options.function_tolerance = cost_tolerance;
  options.num_threads = std::max(1, threads);
  options.logging_type = ceres::SILENT;
  return options;
}

SolveResult solve(const ceres::Solver::Options& options, ceres::Problem& problem) {
  silence_glog();
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  SolveResult result;
  result.stopped = summary.termination_type == ceres::USER_SUCCESS;
  result.iterations = static_cast<int>(summary.iterations.size());
  result.initial_cost = summary.initial_cost;
  result.final_cost = summary.final_cost;
  result.ok = summary.IsSolutionUsable() && summary.final_cost <= summary.initial_cost;
  return result;
}

}  // namespace corvid
