// Loops of flights that are longer than a pose graph may be.
#include "backend/loop.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>

#include "backend/coarse_graph.h"
#include "bench/micro/long_flight.h"

namespace corvid {
namespace {

constexpr std::size_t kNoBound = 1'000'000;

/// Rounds over known ground, then a wide one over new ground back to them, with drift.
struct Return : LongFlight {
  int query, reference;
  Sim3 T_world_query;
  explicit Return(int keyframes, int excursion)
      : LongFlight({.keyframes = keyframes,
                    .excursion = excursion,
                    .landmarks_in_view = 80,
                    .found = 0.8,
                    .drift = 1e-3}),
        query(keyframes - 1),
        reference(keyframes - excursion - 1),
        T_world_query(seen_from(reference, query)) {}
  [[nodiscard]] const Pose& pose(int k) const {
    return map.keyframes[static_cast<std::size_t>(k)].T_world_camera;
  }
};

TEST(LongLoop, ACoarseGraphClosesItAsAFineOneDoes) {
  constexpr int kKeyframes = 900;
  const Return before(kKeyframes, 500);
  Return fine = before, coarse = before;
  ASSERT_TRUE(bend_loop(fine.map, fine.frames, fine.query, fine.reference, fine.T_world_query, 1,
                        kNoBound));
  ASSERT_TRUE(bend_loop(coarse.map, coarse.frames, coarse.query, coarse.reference,
                        coarse.T_world_query, 1, 250));
  double correction = 0, apart = 0, step = 0, turn = 0;
  for (int k = 0; k < kKeyframes; ++k) {
    const Pose &F = fine.pose(k), &C = coarse.pose(k);
    correction = std::max(correction, (F.translation() - before.pose(k).translation()).norm());
    apart = std::max(apart, (F.translation() - C.translation()).norm());
    if (k == 0) continue;
    const Vector6d border =
        ((fine.pose(k - 1).inverse() * F).inverse() * coarse.pose(k - 1).inverse() * C).log();
    step = std::max(step, border.head<3>().norm());
    turn = std::max(turn, border.tail<3>().norm());
  }
  const auto left = [](const Return& r) {
    return (r.pose(r.query).translation() - r.T_world_query.translation()).norm();
  };
  std::printf(
      "of %.3g units %.3g are left, %.3g in the coarse graph; apart %.3g; steps %.2g, %.2g rad\n",
      left(before), left(fine), left(coarse), apart, step, turn);
  ASSERT_GT(left(before), 2.0);
  EXPECT_LT(left(coarse), 0.002 * left(before));
  EXPECT_LT(apart, 0.02 * correction);
  EXPECT_LT(step, 0.002 * 3.3) << "of a step";
  EXPECT_LT(turn, 3e-4);
  // Landmarks follow.
  const auto in_query = [](const Return& r) {
    const MapKeyframe& q = r.map.keyframes.back();
    return Eigen::Vector3d(q.T_world_camera.inverse() * r.map.tracks.at(q.tracks.back()).p_world);
  };
  EXPECT_LT((in_query(coarse) - in_query(fine)).norm(), 0.01);
}

TEST(LongLoop, WhatIsSolvedIsBoundedHoweverLongTheFlight) {
  for (const int keyframes : {1000, 3000}) {
    constexpr std::size_t kMost = 200, kAcross = 2;
    const Return flight(keyframes, 100);
    const LoopGraph graph =
        loop_graph(flight.map, flight.query, flight.reference, flight.T_world_query, kMost);
    EXPECT_EQ(graph.fine.T_world_node.size(), static_cast<std::size_t>(keyframes));
    EXPECT_LE(graph.nodes.size(), kMost);
    EXPECT_GT(graph.nodes.size(), kMost / 2);
    EXPECT_LE(graph.fine.edges.size(), kMost * (2 * 6 + 1)) << "two of each interval are asked";
    const PoseGraph coarse = coarsened(graph.fine, graph.nodes, kAcross);
    EXPECT_EQ(coarse.T_world_node.size(), graph.nodes.size());
    EXPECT_LE(coarse.edges.size(), kMost * (6 + 1 + kAcross));
    // Both ends of the loop, and what is near them.
    for (const int end : {flight.query, flight.reference})
      for (int k = end - 20; k <= std::min(end + 20, keyframes - 1); ++k)
        EXPECT_TRUE(std::binary_search(graph.nodes.begin(), graph.nodes.end(), k)) << k;
    // Rounds hang together across the rounds.
    const auto across = std::count_if(coarse.edges.begin(), coarse.edges.end(),
                                      [](const auto& e) { return std::abs(e.a - e.b) > 1; });
    EXPECT_GT(across, static_cast<std::ptrdiff_t>(kMost) / 2);
  }
}

TEST(LongLoop, AShortChainIsNotCoarsened) {
  const Return flight(300, 100);
  const LoopGraph graph =
      loop_graph(flight.map, flight.query, flight.reference, flight.T_world_query, kMostLoopNodes);
  ASSERT_EQ(graph.nodes.size(), 300U);
  for (const PoseGraphEdge& e : graph.fine.edges) EXPECT_FALSE(e.sqrt_information);
}

TEST(ChooseNodes, NodesAreFarBetweenButWhereThereIsStrain) {
  std::vector<int> strain(1000, 1);
  strain[500] = 1000;                                 // lost
  std::fill(strain.begin() + 900, strain.end(), 50);  // near the loop
  const std::vector<int> nodes = choose_nodes(strain, std::vector<int>{333}, 200);
  EXPECT_LE(nodes.size(), 200U);
  EXPECT_GT(nodes.size(), 150U);
  EXPECT_TRUE(std::is_sorted(nodes.begin(), nodes.end()));
  EXPECT_EQ(nodes.front(), 0);
  EXPECT_EQ(nodes.back(), 1000);
  const auto has = [&](int i) { return std::binary_search(nodes.begin(), nodes.end(), i); };
  for (const int i : {333, 500, 501}) EXPECT_TRUE(has(i)) << i;
  for (int i = 900; i <= 1000; ++i) EXPECT_TRUE(has(i)) << i;
}

TEST(ChooseNodes, AnyInputIsBounded) {
  EXPECT_EQ(choose_nodes({}, {}, 4), std::vector<int>{0});
  EXPECT_EQ(choose_nodes(std::vector<int>{7}, {}, 4), (std::vector<int>{0, 1}));
  std::vector<int> all(5000);
  std::iota(all.begin(), all.end(), -100);
  const std::vector<int> lost(5000, 1000);
  const std::vector<int> nodes = choose_nodes(lost, all, 50);
  EXPECT_LE(nodes.size(), 50U);
  EXPECT_EQ(nodes.back(), 5000);
  EXPECT_THROW((void)choose_nodes(lost, {}, 3), std::logic_error);
}

/// A chain of cameras that are turned against each other, each tied to the two before.
PoseGraph chain(int size) {
  PoseGraph graph;
  Sim3 T;
  for (int i = 0; i < size; ++i) {
    graph.T_world_node.push_back(T);
    T = T * Sim3(1, so3_exp({0.01 * std::sin(i), 0.02, 0.01}), {1, 0.1, 0});
  }
  graph.fixed.assign(graph.T_world_node.size(), 0);
  graph.fixed[0] = 1;
  for (int i = 1; i < size; ++i)
    for (int k = std::max(0, i - 2); k < i; ++k)
      graph.edges.push_back({k, i,
                             graph.T_world_node[static_cast<std::size_t>(k)].inverse() *
                                 graph.T_world_node[static_cast<std::size_t>(i)],
                             0.01, 0.001, 0.005});
  return graph;
}

TEST(CoarseGraph, WithAllNodesItIsTheGraphItself) {
  PoseGraph fine = chain(40);
  fine.edges.push_back({0, 39, fine.T_world_node[39] * Sim3(1.05, so3_exp({0, 0.05, 0}), {1, 2, 0}),
                        1e-3, 1e-3, 1e-3});
  std::vector<int> nodes(40);
  std::iota(nodes.begin(), nodes.end(), 0);
  PoseGraph coarse = coarsened(fine, nodes, 0);
  ASSERT_EQ(coarse.edges.size(), fine.edges.size());
  ASSERT_TRUE(optimise(fine, 20, 1).ok);
  ASSERT_TRUE(optimise(coarse, 20, 1).ok);
  for (std::size_t i = 0; i < 40; ++i)
    EXPECT_LT((fine.T_world_node[i].inverse() * coarse.T_world_node[i]).log().norm(), 1e-6) << i;
}

TEST(CoarseGraph, EachNodeKeepsItsStrongestTiesAcross) {
  PoseGraph fine = chain(201);
  std::vector<int> nodes;
  for (int i = 0; i <= 200; i += 10) nodes.push_back(i);
  // The last part of the chain has seen every other part, and the sixth best.
  for (int k = 3; k < 170; ++k) {
    const double sigma = k / 10 == 6 ? 1e-3 : 1e-2;
    const Sim3 T =
        fine.T_world_node[static_cast<std::size_t>(k)].inverse() * fine.T_world_node[198];
    fine.edges.push_back({k, 198, T, sigma, sigma, sigma});
  }
  const auto across = [&](std::size_t most) {
    std::vector<int> from;
    for (const PoseGraphEdge& e : coarsened(fine, nodes, most).edges)
      if (e.b - e.a > 1) from.push_back(e.a);
    return from;
  };
  EXPECT_EQ(across(100).size(), 18U);
  const std::vector<int> best = across(2);
  ASSERT_EQ(best.size(), 2U);
  for (const int node : best) EXPECT_TRUE(node == 6 || node == 7) << node;
}

TEST(CoarseGraph, WhatIsUnusableIsPassedOver) {
  const double nan = std::nan("");
  PoseGraph fine = chain(20);
  const std::size_t good = coarsened(fine, {0, 9, 19}, 6).edges.size();
  EXPECT_EQ(good, 2U);
  fine.edges.push_back({3, 3, Sim3()});
  fine.edges.push_back({0, 19, Sim3(nan, Eigen::Quaterniond::Identity(), {0, 0, 0})});
  fine.edges.push_back({0, 19, Sim3(), 0, 1, 1});
  EXPECT_EQ(coarsened(fine, {0, 9, 19}, 6).edges.size(), good);
  EXPECT_THROW((void)coarsened(fine, {0, 9}, 6), std::logic_error);
}

TEST(CoarseGraph, AScrewIsSpreadEvenly) {
  PoseGraph fine = chain(11);
  const PoseGraph before = fine;
  PoseGraph coarse = coarsened(fine, {0, 10}, 6);
  Vector7d screw;
  screw << 0.3, 0.1, -0.2, 0.02, 0.3, 0.1, 0.2;
  coarse.T_world_node[1] = Sim3::exp(screw) * coarse.T_world_node[1];
  spread(coarse, {0, 10}, fine);
  for (std::size_t i = 0; i <= 10; ++i) {
    const Sim3 wanted = Sim3::exp(0.1 * static_cast<double>(i) * screw) * before.T_world_node[i];
    EXPECT_LT((wanted.inverse() * fine.T_world_node[i]).log().norm(), 1e-9) << i;
  }
}

}  // namespace
}  // namespace corvid
