// Analytic against automatic derivatives of the reprojection error: one evaluation of every cost,
// and a window adjustment of the size that recorded flights have. docs/decisions/jacobians.md.
#include <benchmark/benchmark.h>
#include <ceres/loss_function.h>
#include <ceres/problem.h>

#include <cmath>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "backend/ceres_solve.h"
#include "backend/costs/reprojection.h"
#include "bench/micro/automatic_reprojection.h"

namespace corvid {
namespace {

Camera camera_of(CameraModel model) {
  Camera c;
  c.model = model;
  c.width_px = 752;
  c.height_px = 480;
  c.fx_px = 458.7;
  c.fy_px = 457.3;
  c.cx_px = 367.2;
  c.cy_px = 248.4;
  if (model == CameraModel::radtan) c.distortion = {-0.28, 0.074, 0.0002, 1.8e-5, 0};
  if (model == CameraModel::equidistant) c.distortion = {-0.01, 0.005, -0.002, 0.0003, 0};
  return c;
}

/// A window's poses in a row, points before them, and what is seen of them.
struct Scene {
  struct View {
    std::size_t pose, point;
    Eigen::Vector2d pixel;
  };
  Camera camera;
  std::vector<PoseBlock> poses;
  std::vector<Eigen::Vector3d> points;
  std::vector<View> views;
};

Scene make_scene(CameraModel model, std::size_t poses, std::size_t points) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> u(-1, 1);
  std::normal_distribution<double> noise(0, 0.3);
  Scene s;
  s.camera = camera_of(model);
  std::vector<Pose> truth;
  for (std::size_t i = 0; i < poses; ++i)
    truth.emplace_back(so3_exp({0.03 * u(random), 0.03 * u(random), 0.03 * u(random)}),
                       Eigen::Vector3d(0.2 * static_cast<double>(i), 0.05 * u(random), 0));
  for (std::size_t j = 0; j < points; ++j) {
    const Eigen::Vector3d p(0.1 * static_cast<double>(poses) * (1 + u(random)), 2 * u(random),
                            5 + 2 * u(random));
    for (std::size_t i = 0; i < poses; ++i) {
      const auto pixel = s.camera.project(truth[i].inverse() * p);
      if (pixel && s.camera.in_image(*pixel))
        s.views.push_back({i, j, *pixel + Eigen::Vector2d(noise(random), noise(random))});
    }
    s.points.push_back(p + 0.05 * Eigen::Vector3d(u(random), u(random), u(random)));
  }
  for (std::size_t i = 0; i < poses; ++i) {
    Vector6d d = Vector6d::Zero();
    if (i >= poses / 2)
      for (int k = 0; k < 6; ++k) d(k) = 0.005 * u(random);
    s.poses.push_back(to_block(truth[i] * Pose::exp(d)));
  }
  return s;
}

struct Analytic {
  using Manifold = PoseManifold;
  static std::unique_ptr<ceres::CostFunction> cost(const Camera* c, const Eigen::Vector2d& pixel,
                                                   bool intrinsics) {
    if (intrinsics) return std::make_unique<IntrinsicsReprojectionCost>(c, pixel, 1.0);
    return std::make_unique<ReprojectionCost>(c, pixel, 1.0);
  }
};

struct Automatic {
  using Manifold = AutomaticPoseManifold;
  static std::unique_ptr<ceres::CostFunction> cost(const Camera* c, const Eigen::Vector2d& pixel,
                                                   bool intrinsics) {
    auto* functor = new AutomaticReprojection{c, pixel, 1.0};  // the cost function owns it
    if (intrinsics) return std::make_unique<AutomaticIntrinsicsCost>(functor);
    return std::make_unique<AutomaticReprojectionCost>(functor);
  }
};

/// One evaluation with all Jacobians, brought to the tangent of the pose as Ceres does it.
template <class Way>
void evaluation(benchmark::State& state, CameraModel model, bool intrinsics) {
  const Scene s = make_scene(model, 8, 500);
  const typename Way::Manifold manifold;
  const IntrinsicsBlock k = intrinsics_block(s.camera, s.camera);
  std::vector<std::unique_ptr<ceres::CostFunction>> costs;
  for (const Scene::View& v : s.views) costs.push_back(Way::cost(&s.camera, v.pixel, intrinsics));
  double r[2], d_pose[14], d_point[6], d_intrinsics[16], tangent[12], plus[42];
  double* jacobians[] = {d_pose, d_point, d_intrinsics};
  std::size_t i = 0;
  for (auto _ : state) {
    const Scene::View& v = s.views[i];
    const double* blocks[] = {s.poses[v.pose].data(), s.points[v.point].data(), k.data()};
    costs[i]->Evaluate(blocks, r, jacobians);
    manifold.PlusJacobian(blocks[0], plus);
    manifold.RightMultiplyByPlusJacobian(blocks[0], 2, d_pose, tangent);
    benchmark::DoNotOptimize(tangent);
    benchmark::DoNotOptimize(d_point);
    benchmark::DoNotOptimize(d_intrinsics);
    if (++i == s.views.size()) i = 0;
  }
}

/// Half of the poses move; four iterations, so that both ways do the same work.
template <class Way>
void window(benchmark::State& state, CameraModel model, bool intrinsics) {
  const Scene scene = make_scene(model, 20, 1000);
  double cost = 0;
  for (auto _ : state) {
    Scene s = scene;
    IntrinsicsBlock k = intrinsics_block(s.camera, s.camera);
    typename Way::Manifold manifold;
    ceres::HuberLoss loss(1);
    std::vector<std::unique_ptr<ceres::CostFunction>> costs;
    ceres::Problem::Options options;
    options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    options.disable_all_safety_checks = true;
    ceres::Problem problem(options);
    ceres::Solver::Options solver = solver_options(4, 0, 1);
    solver.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    for (std::size_t i = 0; i < s.poses.size(); ++i) {
      problem.AddParameterBlock(s.poses[i].data(), 7, &manifold);
      if (i < s.poses.size() / 2) problem.SetParameterBlockConstant(s.poses[i].data());
      solver.linear_solver_ordering->AddElementToGroup(s.poses[i].data(), 1);
    }
    for (const Scene::View& v : s.views) {
      costs.push_back(Way::cost(&s.camera, v.pixel, intrinsics));
      std::vector<double*> blocks{s.poses[v.pose].data(), s.points[v.point].data()};
      if (intrinsics) blocks.push_back(k.data());
      problem.AddResidualBlock(costs.back().get(), &loss, blocks);
      solver.linear_solver_ordering->AddElementToGroup(blocks[1], 0);
    }
    if (intrinsics) solver.linear_solver_ordering->AddElementToGroup(k.data(), 1);
    solver.linear_solver_type = ceres::DENSE_SCHUR;
    solver.gradient_tolerance = solver.parameter_tolerance = 0;
    solver.initial_trust_region_radius = 1e5;
    cost = solve(solver, problem).final_cost;
  }
  state.counters["views"] = static_cast<double>(scene.views.size());
  state.counters["final_cost"] = cost;
}

void add_all() {
  for (const CameraModel model :
       {CameraModel::pinhole, CameraModel::radtan, CameraModel::equidistant}) {
    for (const bool intrinsics : {false, true}) {
      if (model == CameraModel::pinhole && intrinsics) continue;
      const std::string name = std::string(to_string(model)) + (intrinsics ? "_intrinsics/" : "/");
      benchmark::RegisterBenchmark(("evaluation/" + name + "analytic").c_str(),
                                   evaluation<Analytic>, model, intrinsics);
      benchmark::RegisterBenchmark(("evaluation/" + name + "automatic").c_str(),
                                   evaluation<Automatic>, model, intrinsics);
      benchmark::RegisterBenchmark(("window/" + name + "analytic").c_str(), window<Analytic>, model,
                                   intrinsics)
          ->Unit(benchmark::kMillisecond);
      benchmark::RegisterBenchmark(("window/" + name + "automatic").c_str(), window<Automatic>,
                                   model, intrinsics)
          ->Unit(benchmark::kMillisecond);
    }
  }
}

}  // namespace
}  // namespace corvid

int main(int argc, char** argv) {
  corvid::add_all();
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
  return 0;
}
