#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "backend/solve_result.h"
#include "corvid/pose.h"

namespace corvid {

using Matrix7d = Eigen::Matrix<double, 7, 7>;

/// How one node lies in another, as it was measured: T_a_b = T_world_a^-1 T_world_b.
struct PoseGraphEdge {
  int a = 0, b = 0;  ///< positions in PoseGraph::T_world_node
  Sim3 T_a_b;
  /// Standard deviations of the translation [units of a], the rotation and the log of the scale.
  double sigma_translation = 1, sigma_rotation_rad = 1, sigma_log_scale = 1;
  /// Instead of the standard deviations, where errors hang together: of edge_error().
  std::optional<Matrix7d> sqrt_information = std::nullopt;
};

/// Not from a node to itself, finite, and with positive standard deviations.
[[nodiscard]] bool usable(const PoseGraphEdge& edge);
/// So that sqrt_information * edge_error() has unit covariance.
[[nodiscard]] Matrix7d sqrt_information(const PoseGraphEdge& edge);

/// Cameras whose scale drifts: each node maps its own camera frame, with its own unit of length, to
/// the world (Strasdat, Montiel and Davison, "Scale drift-aware large scale monocular SLAM", RSS
/// 2010).
struct PoseGraph {
  std::vector<Sim3> T_world_node;
  std::vector<std::uint8_t> fixed;  ///< one per node
  std::vector<PoseGraphEdge> edges;
};

/// Error of an edge, in tangent coordinates (rho, phi, sigma): log(T_a_b^-1 T_world_a^-1
/// T_world_b).
[[nodiscard]] Vector7d edge_error(const Sim3& T_a_b, const Sim3& T_world_a, const Sim3& T_world_b);

/// Ad(S): S exp(d) = exp(Ad(S) d) S.
[[nodiscard]] Matrix7d adjoint(const Sim3& S);

/// Derivatives of edge_error() by right perturbations of the two nodes.
void edge_jacobians(const Sim3& T_a_b, const Sim3& T_world_a, const Sim3& T_world_b, Matrix7d* d_a,
                    Matrix7d* d_b);

/// Moves the free nodes so that the edges' errors are least, in weighted least squares
/// (Levenberg-Marquardt, sparse Cholesky; Ceres). Nodes without a path of edges to a fixed one stay
/// where they are. Edges that are not finite, or whose sigma is not positive, are passed over.
/// Nothing is changed if it fails. Deterministic if threads == 1.
SolveResult optimise(PoseGraph& graph, int max_iterations, int threads);

}  // namespace corvid
