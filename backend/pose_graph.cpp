#include "backend/pose_graph.h"

#include <ceres/manifold.h>
#include <ceres/problem.h>
#include <ceres/sized_cost_function.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <utility>

#include "backend/ceres_solve.h"
#include "core/check.h"

namespace corvid {
namespace {

/// A similarity as a Ceres block: qx qy qz qw tx ty tz s.
using Sim3Block = std::array<double, 8>;

Sim3Block to_block(const Sim3& S) {
  const auto& q = S.rotation().coeffs();
  const auto& t = S.translation();
  return {q[0], q[1], q[2], q[3], t[0], t[1], t[2], S.scale()};
}

Sim3 from_block(const double* b) {
  return {b[7], Eigen::Quaterniond(b[3], b[0], b[1], b[2]), {b[4], b[5], b[6]}};
}

bool finite(const Sim3& S) {
  return S.rotation().coeffs().allFinite() && S.translation().allFinite() &&
         std::isfinite(S.scale()) && S.scale() > 0;
}

/// Sim(3) with perturbation on the right. As with PoseManifold, the cost writes derivatives by the
/// tangent vector into the first seven of the eight columns.
class Sim3Manifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 8; }
  int TangentSize() const override { return 7; }
  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override {
    Vector7d d = Eigen::Map<const Vector7d>(delta);
    d[6] = std::clamp(d[6], -20.0, 20.0);  // Ceres tries the whole gradient, whose exp() overflows
    const Sim3 moved = from_block(x) * Sim3::exp(d);
    if (!finite(moved)) return false;
    const Sim3Block block = to_block(moved);
    std::copy(block.begin(), block.end(), x_plus_delta);
    return true;
  }
  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 8, 7, Eigen::RowMajor>>(jacobian).setIdentity();
    return true;
  }
  bool Minus(const double* y, const double* x, double* y_minus_x) const override {
    Eigen::Map<Vector7d>(y_minus_x, 7) = (from_block(x).inverse() * from_block(y)).log();
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 7, 8, Eigen::RowMajor>>(jacobian).setIdentity();
    return true;
  }
};

/// Inverse of the right Jacobian: log(exp(x) exp(d)) = x + J d + O(d^2); the series
/// I + ad/2 + ad^2/12 - ad^4/720 + ad^6/30240 of the adjoint ad of x, with an error below 1e-6 for
/// |x| < 1.
Matrix7d right_jacobian_inverse(const Vector7d& x) {
  const Eigen::Vector3d rho = x.head<3>(), phi = x.segment<3>(3);
  Matrix7d ad = Matrix7d::Zero();
  ad.topLeftCorner<3, 3>() = skew(phi) + x[6] * Eigen::Matrix3d::Identity();
  ad.block<3, 3>(0, 3) = skew(rho);
  ad.block<3, 1>(0, 6) = -rho;
  ad.block<3, 3>(3, 3) = skew(phi);
  const Matrix7d ad2 = ad * ad, ad4 = ad2 * ad2;
  return Matrix7d::Identity() + ad / 2 + ad2 / 12 - ad4 / 720 + ad4 * ad2 / 30240;
}

class EdgeCost final : public ceres::SizedCostFunction<7, 8, 8> {
 public:
  explicit EdgeCost(const PoseGraphEdge& edge)
      : T_a_b_(edge.T_a_b), weight_(sqrt_information(edge)) {}
  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override {
    const Sim3 A = from_block(parameters[0]), B = from_block(parameters[1]);
    Eigen::Map<Vector7d>(residuals, 7) = weight_ * edge_error(T_a_b_, A, B);
    if (jacobians == nullptr) return true;
    Matrix7d d[2];
    edge_jacobians(T_a_b_, A, B, &d[0], &d[1]);
    for (int i = 0; i < 2; ++i) {
      if (jacobians[i] == nullptr) continue;
      Eigen::Map<Eigen::Matrix<double, 7, 8, Eigen::RowMajor>> J(jacobians[i]);
      J.leftCols<7>() = weight_ * d[i];
      J.col(7).setZero();
    }
    return true;
  }

 private:
  Sim3 T_a_b_;
  Matrix7d weight_;
};

/// Nodes that edges tie to a fixed one.
std::vector<std::uint8_t> tied(const PoseGraph& graph) {
  std::vector<std::vector<int>> next(graph.T_world_node.size());
  for (const PoseGraphEdge& e : graph.edges) {
    if (!usable(e)) continue;
    next[static_cast<std::size_t>(e.a)].push_back(e.b);
    next[static_cast<std::size_t>(e.b)].push_back(e.a);
  }
  std::vector<std::uint8_t> reached = graph.fixed;
  std::vector<int> open;
  for (std::size_t i = 0; i < reached.size(); ++i)
    if (reached[i] != 0) open.push_back(static_cast<int>(i));
  while (!open.empty()) {
    const int i = open.back();
    open.pop_back();
    for (const int k : next[static_cast<std::size_t>(i)]) {
      if (std::exchange(reached[static_cast<std::size_t>(k)], 1) == 0) open.push_back(k);
    }
  }
  return reached;
}

}  // namespace

bool usable(const PoseGraphEdge& e) {
  const auto good = [](double sigma) { return std::isfinite(sigma) && sigma > 0; };
  if (e.a == e.b || !finite(e.T_a_b)) return false;
  if (e.sqrt_information) return e.sqrt_information->allFinite();
  return good(e.sigma_translation) && good(e.sigma_rotation_rad) && good(e.sigma_log_scale);
}

Matrix7d sqrt_information(const PoseGraphEdge& edge) {
  if (edge.sqrt_information) return *edge.sqrt_information;
  Vector7d weight;
  weight.head<3>().setConstant(1 / edge.sigma_translation);
  weight.segment<3>(3).setConstant(1 / edge.sigma_rotation_rad);
  weight[6] = 1 / edge.sigma_log_scale;
  return weight.asDiagonal();
}

Vector7d edge_error(const Sim3& T_a_b, const Sim3& T_world_a, const Sim3& T_world_b) {
  return (T_a_b.inverse() * T_world_a.inverse() * T_world_b).log();
}

Matrix7d adjoint(const Sim3& S) {
  const Eigen::Matrix3d R = S.rotation().toRotationMatrix();
  Matrix7d ad = Matrix7d::Zero();
  ad.topLeftCorner<3, 3>() = S.scale() * R;
  ad.block<3, 3>(0, 3) = skew(S.translation()) * R;
  ad.block<3, 1>(0, 6) = -S.translation();
  ad.block<3, 3>(3, 3) = R;
  ad(6, 6) = 1;
  return ad;
}

void edge_jacobians(const Sim3& T_a_b, const Sim3& T_world_a, const Sim3& T_world_b, Matrix7d* d_a,
                    Matrix7d* d_b) {
  *d_b = right_jacobian_inverse(edge_error(T_a_b, T_world_a, T_world_b));
  // exp(-d) T_a^-1 T_b = T_a^-1 T_b exp(-Ad(T_b^-1 T_a) d).
  *d_a = -*d_b * adjoint(T_world_b.inverse() * T_world_a);
}

SolveResult optimise(PoseGraph& graph, int max_iterations, int threads) {
  CORVID_CHECK(graph.fixed.size() == graph.T_world_node.size(), "one flag per node");
  const int size = static_cast<int>(graph.T_world_node.size());
  for (const PoseGraphEdge& e : graph.edges)
    CORVID_CHECK(e.a >= 0 && e.a < size && e.b >= 0 && e.b < size, "no such node");
  for (const Sim3& S : graph.T_world_node)
    if (!finite(S)) return {};
  std::vector<Sim3Block> blocks;
  blocks.reserve(graph.T_world_node.size());
  for (const Sim3& S : graph.T_world_node) blocks.push_back(to_block(S));
  const std::vector<std::uint8_t> movable = tied(graph);

  Sim3Manifold manifold;
  std::deque<EdgeCost> costs;
  ceres::Problem::Options options;
  options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(options);
  for (const PoseGraphEdge& e : graph.edges) {
    const auto a = static_cast<std::size_t>(e.a), b = static_cast<std::size_t>(e.b);
    if (!usable(e) || movable[a] == 0 || (graph.fixed[a] != 0 && graph.fixed[b] != 0)) continue;
    costs.emplace_back(e);
    problem.AddResidualBlock(&costs.back(), nullptr, blocks[a].data(), blocks[b].data());
  }
  if (costs.empty()) return {};
  for (std::size_t i = 0; i < blocks.size(); ++i) {
    if (!problem.HasParameterBlock(blocks[i].data())) continue;
    problem.SetManifold(blocks[i].data(), &manifold);
    if (graph.fixed[i] != 0) problem.SetParameterBlockConstant(blocks[i].data());
  }

  constexpr double kCostTolerance = 1e-6;
  ceres::Solver::Options solver = solver_options(max_iterations, kCostTolerance, threads);
  solver.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  solver.initial_trust_region_radius = 1e8;
  SolveResult result = solve(solver, problem);
  if (!std::exchange(result.ok, false)) return result;
  std::vector<Sim3> moved;
  for (const Sim3Block& block : blocks) {
    moved.push_back(from_block(block.data()));
    if (!finite(moved.back())) return result;
  }
  for (std::size_t i = 0; i < moved.size(); ++i)
    if (graph.fixed[i] == 0 && problem.HasParameterBlock(blocks[i].data()))
      graph.T_world_node[i] = moved[i];
  result.ok = true;
  return result;
}

}  // namespace corvid
