#include "backend/bundle.h"

#include <ceres/iteration_callback.h>
#include <ceres/loss_function.h>
#include <ceres/problem.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>
#include <utility>

#include "backend/ceres_solve.h"
#include "backend/costs/position.h"
#include "backend/costs/reprojection.h"
#include "core/check.h"
#include "core/median.h"

namespace corvid {
namespace {

constexpr int kDenseLimit = 40;  ///< free poses up to which the reduced system is solved densely

double median_sigma(const std::vector<BundleObservation>& observations) {
  std::vector<double> sigmas;
  sigmas.reserve(observations.size());
  for (const BundleObservation& o : observations) sigmas.push_back(o.sigma_px);
  return upper_median(std::move(sigmas));
}

/// One over the prior's standard deviations: a tenth of the focal length, a fiftieth of it for the
/// principal point, and for the distortion what lenses have, or what rectification leaves.
IntrinsicsBlock prior_weights(IntrinsicsFreedom freedom, double sigma_px) {
  const double k = freedom == IntrinsicsFreedom::radial ? 0.02 : 0.1;
  IntrinsicsBlock weights{0.1, 0.02, 0.02, k, k, 0.01, 0.01, k};
  for (double& w : weights) w = sigma_px / w;
  return weights;
}

/// Positions in the block of the intrinsics that stay.
std::vector<int> held_intrinsics(IntrinsicsFreedom freedom, CameraModel model) {
  const bool distorts = model == CameraModel::radtan || model == CameraModel::equidistant;
  std::vector<int> held;
  if (freedom == IntrinsicsFreedom::radial) held.push_back(0);
  if (freedom != IntrinsicsFreedom::all) held.insert(held.end(), {1, 2});
  if (!distorts) held.insert(held.end(), {3, 4});
  if (!distorts || freedom != IntrinsicsFreedom::all) held.insert(held.end(), {5, 6});
  if (model != CameraModel::radtan || freedom != IntrinsicsFreedom::all) held.push_back(7);
  return held;
}

/// What the observations' errors are in units of their sigma, from the median of those of up to a
/// thousand (the median of a squared Rayleigh variable is 2 ln 2): at least a half.
double error_factor(const BundleProblem& problem) {
  constexpr std::size_t kMost = 1000;
  std::vector<double> squares;
  const std::size_t step = problem.observations.size() / kMost + 1;
  for (std::size_t i = 0; i < problem.observations.size(); i += step) {
    const BundleObservation& o = problem.observations[i];
    const Pose& T = problem.T_world_camera[static_cast<std::size_t>(o.pose)];
    const auto pixel =
        problem.camera.project(T.inverse() * problem.points[static_cast<std::size_t>(o.point)]);
    if (pixel) squares.push_back((*pixel - o.pixel).squaredNorm() / (o.sigma_px * o.sigma_px));
  }
  if (squares.empty()) return 1;
  return std::max(0.5, std::sqrt(upper_median(std::move(squares)) / (2 * std::log(2.0))));
}

/// Tells how far the solver is, and stops it when asked to.
class IterationWatch final : public ceres::IterationCallback {
 public:
  explicit IterationWatch(const BundleSettings& settings) : settings_(settings) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (settings_.on_iteration) settings_.on_iteration(summary.iteration, summary.cost);
    return settings_.stop.stop_requested() ? ceres::SOLVER_TERMINATE_SUCCESSFULLY
                                           : ceres::SOLVER_CONTINUE;
  }

 private:
  const BundleSettings& settings_;
};

}  // namespace

SolveResult adjust(BundleProblem& problem, const BundleSettings& settings) {
  CORVID_CHECK(problem.fixed.size() == problem.T_world_camera.size(), "one flag per pose");
  if (problem.observations.empty()) return {};

  std::vector<PoseBlock> poses;
  poses.reserve(problem.T_world_camera.size());
  for (const Pose& T : problem.T_world_camera) poses.push_back(to_block(T));
  std::vector<Eigen::Vector3d> points = problem.points;
  const bool refine = settings.freedom != IntrinsicsFreedom::fixed;
  const Camera reference = refine ? settings.intrinsics_prior : problem.camera;
  IntrinsicsBlock intrinsics = intrinsics_block(problem.camera, reference);
  const double sigma = median_sigma(problem.observations);

  // Everything below outlives the Ceres problem, which owns nothing: few allocations.
  PoseManifold manifold;
  ceres::HuberLoss loss(settings.huber_px);
  std::deque<ReprojectionCost> costs;
  std::deque<IntrinsicsReprojectionCost> intrinsics_costs;
  std::deque<DistanceCost> distances;
  std::deque<PositionCost> positions;
  const IntrinsicsPriorCost prior(intrinsics_block(reference, reference),
                                  prior_weights(settings.freedom, sigma));
  ceres::SubsetManifold intrinsics_manifold(8, held_intrinsics(settings.freedom, reference.model));

  ceres::Problem::Options options;
  options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.disable_all_safety_checks = true;
  ceres::Problem ceres_problem(options);
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  int free_poses = 0;
  std::vector<std::uint8_t> used(poses.size(), 0);
  for (const BundleObservation& o : problem.observations) {
    used[static_cast<std::size_t>(o.pose)] = 1;
  }
  for (const auto& [a, b] : problem.hold_distance) {
    used[static_cast<std::size_t>(a)] = used[static_cast<std::size_t>(b)] = 1;
  }
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (used[i] == 0) continue;
    ceres_problem.AddParameterBlock(poses[i].data(), 7, &manifold);
    if (problem.fixed[i] != 0) {
      ceres_problem.SetParameterBlockConstant(poses[i].data());
    } else {
      ++free_poses;
    }
    ordering->AddElementToGroup(poses[i].data(), 1);
  }
  for (auto& point : points) ordering->AddElementToGroup(point.data(), 0);
  for (const BundleObservation& o : problem.observations) {
    double* const pose = poses[static_cast<std::size_t>(o.pose)].data();
    double* const point = points[static_cast<std::size_t>(o.point)].data();
    const double weight = sigma / o.sigma_px;
    if (refine) {
      intrinsics_costs.emplace_back(&reference, o.pixel, weight);
      ceres_problem.AddResidualBlock(&intrinsics_costs.back(), &loss, pose, point,
                                     intrinsics.data());
    } else {
      costs.emplace_back(&problem.camera, o.pixel, weight);
      ceres_problem.AddResidualBlock(&costs.back(), &loss, pose, point);
    }
  }
  for (std::size_t i = points.size(); i-- > 0;) {
    if (!ceres_problem.HasParameterBlock(points[i].data())) ordering->Remove(points[i].data());
  }
  if (refine) {
    ceres_problem.AddResidualBlock(const_cast<IntrinsicsPriorCost*>(&prior), nullptr,
                                   intrinsics.data());
    ceres_problem.SetManifold(intrinsics.data(), &intrinsics_manifold);
    ordering->AddElementToGroup(intrinsics.data(), 1);
  }
  for (const auto& [a, b] : problem.hold_distance) {
    const auto ia = static_cast<std::size_t>(a), ib = static_cast<std::size_t>(b);
    const double d =
        (problem.T_world_camera[ib].translation() - problem.T_world_camera[ia].translation())
            .norm();
    if (!(d > 0)) continue;
    // The gauge is free, so any weight gives the same shape; this one keeps the system well scaled.
    distances.emplace_back(d, 1e3 / d);
    ceres_problem.AddResidualBlock(&distances.back(), nullptr, poses[ia].data(), poses[ib].data());
  }

  const double unit = problem.positions.empty() ? 1 : sigma * error_factor(problem);
  ceres::HuberLoss position_loss(4 * unit);
  for (const BundlePosition& p : problem.positions) {
    double* const pose = poses[static_cast<std::size_t>(p.pose)].data();
    if (!ceres_problem.HasParameterBlock(pose)) continue;
    positions.emplace_back(p.p_world, unit * p.sqrt_information);
    ceres_problem.AddResidualBlock(&positions.back(), &position_loss, pose);
  }

  ceres::Solver::Options solver =
      solver_options(settings.max_iterations, settings.cost_tolerance, settings.threads);
  solver.linear_solver_type = free_poses <= kDenseLimit ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  solver.linear_solver_ordering = ordering;
  solver.parameter_tolerance = 1e-9;
  solver.initial_trust_region_radius = 1e5;
  IterationWatch watch(settings);
  solver.callbacks.push_back(&watch);
  SolveResult result = solve(solver, ceres_problem);
  if (!std::exchange(result.ok, false)) return result;
  for (const auto& block : poses) {
    if (!std::all_of(block.begin(), block.end(), [](double v) { return std::isfinite(v); })) {
      return result;
    }
  }
  for (const auto& point : points) {
    if (!point.allFinite()) return result;
  }
  if (refine) {
    const Camera camera = apply_intrinsics(reference, intrinsics.data());
    if (!camera.validate().empty()) return result;
    problem.camera = camera;
  }
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (used[i] != 0 && problem.fixed[i] == 0) {
      problem.T_world_camera[i] = from_block(poses[i].data());
    }
  }
  problem.points = std::move(points);
  result.ok = true;
  return result;
}

}  // namespace corvid
