#include "backend/pose_graph.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

namespace corvid {
namespace {

Sim3 random_similarity(std::mt19937_64& random, double size) {
  std::uniform_real_distribution<double> u(-size, size);
  Vector7d d;
  for (int i = 0; i < 7; ++i) d[i] = u(random);
  return Sim3::exp(d);
}

TEST(PoseGraph, JacobiansAreThoseOfFiniteDifferences) {
  std::mt19937_64 random(3);
  for (int trial = 0; trial < 20; ++trial) {
    const Sim3 A = random_similarity(random, 1.5), B = random_similarity(random, 1.5);
    const Sim3 T_a_b = A.inverse() * B * random_similarity(random, 0.2);
    Matrix7d d[2];
    edge_jacobians(T_a_b, A, B, &d[0], &d[1]);
    for (int node = 0; node < 2; ++node)
      for (int k = 0; k < 7; ++k) {
        constexpr double kStep = 1e-6;
        const auto moved = [&](double step) {
          const Sim3 S = Sim3::exp(step * Vector7d::Unit(k));
          return edge_error(T_a_b, node == 0 ? A * S : A, node == 1 ? B * S : B);
        };
        const Vector7d numeric = (moved(kStep) - moved(-kStep)) / (2 * kStep);
        EXPECT_LT((numeric - d[node].col(k)).norm(), 1e-5) << "node " << node << ", " << k;
      }
  }
}

/// A circle of cameras whose every step drifts in direction and in scale; node `nodes` is node 0
/// seen again.
struct Circle {
  PoseGraph graph;
  std::vector<Sim3> truth;

  explicit Circle(int nodes, double drift) {
    std::mt19937_64 random(5);
    for (int i = 0; i <= nodes; ++i) {
      const double angle = 2 * std::numbers::pi * i / nodes;
      truth.emplace_back(1, so3_exp({0, 0, angle}),
                         Eigen::Vector3d(10 * std::cos(angle), 10 * std::sin(angle), 0));
    }
    for (int i = 0; i < nodes; ++i) {
      const auto k = static_cast<std::size_t>(i);
      Vector7d step = drift * Vector7d::Ones() + random_similarity(random, drift).log();
      const Sim3 T_a_b = truth[k].inverse() * truth[k + 1] * Sim3::exp(step);
      graph.edges.push_back({i, i + 1, T_a_b, 0.01, 0.01, 0.01});
    }
    graph.T_world_node.push_back(truth.front());
    for (const PoseGraphEdge& e : graph.edges)
      graph.T_world_node.push_back(graph.T_world_node.back() * e.T_a_b);
    graph.fixed.assign(graph.T_world_node.size(), 0);
    graph.fixed[0] = 1;
  }
  [[nodiscard]] double error(std::size_t k) const {
    return (graph.T_world_node[k].translation() - truth[k].translation()).norm();
  }
};

TEST(PoseGraph, ACircleThatDriftsCloses) {
  constexpr int kNodes = 200;
  Circle circle(kNodes, 5e-4);
  const double before_end = circle.error(kNodes), before_half = circle.error(kNodes / 2);
  ASSERT_GT(before_end, 1.0);
  ASSERT_GT(std::abs(circle.graph.T_world_node.back().scale() - 1), 0.05);
  circle.graph.edges.push_back({0, kNodes, Sim3(), 1e-4, 1e-4, 1e-4});
  const SolveResult result = optimise(circle.graph, 50, 1);
  EXPECT_TRUE(result.ok);
  EXPECT_LT(result.final_cost, 0.1 * result.initial_cost);
  EXPECT_LT(circle.error(kNodes), 1e-3);
  EXPECT_NEAR(circle.graph.T_world_node.back().scale(), 1, 1e-3);
  EXPECT_LT(circle.error(kNodes / 2), before_half) << "what lies between is better, too";
  EXPECT_EQ(circle.error(0), 0);
}

TEST(PoseGraph, WithoutAnErrorNothingMoves) {
  Circle circle(20, 0);
  circle.graph.edges.push_back({0, 20, Sim3(), 1e-4, 1e-4, 1e-4});
  EXPECT_TRUE(optimise(circle.graph, 50, 1).ok);
  for (std::size_t k = 0; k < circle.truth.size(); ++k) EXPECT_LT(circle.error(k), 1e-9);
}

TEST(PoseGraph, NodesThatNothingHoldsStayWhereTheyAre) {
  PoseGraph graph;
  graph.T_world_node = {Sim3(), Sim3(1, Eigen::Quaterniond::Identity(), {1, 0, 0}),
                        Sim3(1, Eigen::Quaterniond::Identity(), {5, 0, 0}),
                        Sim3(1, Eigen::Quaterniond::Identity(), {7, 0, 0})};
  graph.fixed = {1, 0, 0, 0};
  graph.edges = {{0, 1, Sim3(1, Eigen::Quaterniond::Identity(), {2, 0, 0})},
                 {2, 3, Sim3(1, Eigen::Quaterniond::Identity(), {9, 0, 0})}};
  EXPECT_TRUE(optimise(graph, 20, 1).ok);
  EXPECT_NEAR(graph.T_world_node[1].translation().x(), 2, 1e-6);
  EXPECT_EQ(graph.T_world_node[2].translation().x(), 5);
  EXPECT_EQ(graph.T_world_node[3].translation().x(), 7);
}

TEST(PoseGraph, BadInputsChangeNothing) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  PoseGraph empty;
  EXPECT_FALSE(optimise(empty, 10, 1).ok);

  Circle broken(10, 1e-3);
  broken.graph.T_world_node[4] = Sim3(1, Eigen::Quaterniond::Identity(), {nan, 0, 0});
  EXPECT_FALSE(optimise(broken.graph, 10, 1).ok);

  Circle circle(10, 1e-3);
  const PoseGraph before = circle.graph;
  circle.graph.edges = {{0, 3, Sim3(nan, Eigen::Quaterniond::Identity(), {0, 0, 0})},
                        {0, 4, Sim3(), 0, 1, 1},
                        {5, 5, Sim3()}};
  EXPECT_FALSE(optimise(circle.graph, 10, 1).ok) << "no edge is of use";
  for (std::size_t k = 0; k < before.T_world_node.size(); ++k)
    EXPECT_EQ(circle.graph.T_world_node[k].translation(), before.T_world_node[k].translation());

  circle.graph.edges = {{0, 99, Sim3()}};
  EXPECT_THROW(optimise(circle.graph, 10, 1), std::logic_error);
}

}  // namespace
}  // namespace corvid
