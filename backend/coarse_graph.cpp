#include "backend/coarse_graph.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <numeric>
#include <utility>

#include "core/check.h"

namespace corvid {
namespace {

/// Whether nodes with at most `most_strain` between them are at most `most`; they are put in
/// `nodes`.
bool fits(std::span<const int> strain, std::span<const std::uint8_t> must, std::int64_t most_strain,
          std::size_t most, std::vector<int>& nodes) {
  nodes.assign(1, 0);
  std::int64_t sum = 0;
  for (std::size_t i = 0; i < strain.size(); ++i) {
    const int here = static_cast<int>(i);
    sum += strain[i];
    if (nodes.back() != here && (must[i] != 0 || sum > most_strain)) {
      nodes.push_back(here);
      sum = strain[i];
    }
  }
  if (!strain.empty()) nodes.push_back(static_cast<int>(strain.size()));
  return nodes.size() <= most;
}

/// Where a node of the fine graph lies: `share` of the way from coarse node `before` to the next.
struct Between {
  int before = 0;
  double share = 0;
  [[nodiscard]] int nearest() const { return before + (share < 0.5 ? 0 : 1); }
  [[nodiscard]] bool is_node() const { return share == 0; }
};

std::vector<Between> places_between(const std::vector<int>& nodes) {
  std::vector<Between> places;
  for (std::size_t n = 0; n + 1 < nodes.size(); ++n) {
    const int length = nodes[n + 1] - nodes[n];
    for (int i = 0; i < length; ++i)
      places.push_back({static_cast<int>(n), static_cast<double>(i) / length});
  }
  places.push_back({static_cast<int>(nodes.size()) - 1, 0.0});
  return places;
}

/// Normal equations of all that ties two coarse nodes, by the right perturbation of the second.
struct Tie {
  Matrix7d H = Matrix7d::Zero();
  Vector7d g = Vector7d::Zero();
  bool direct = false;  ///< among what it stands for is an edge between the two themselves
};
using Ties = std::map<std::pair<int, int>, Tie>;

/// Adds fine edges to the ties of coarse nodes.
class Projection {
 public:
  Projection(const PoseGraph& fine, const std::vector<int>& nodes)
      : fine_(fine), nodes_(nodes), places_(places_between(nodes)) {}

  void add(const PoseGraphEdge& e) {
    const Between& a = places_[static_cast<std::size_t>(e.a)];
    const Between& b = places_[static_cast<std::size_t>(e.b)];
    if (a.is_node() && b.is_node()) {
      tie(e, a.before, b.before, 1, 1);
      ties_[{a.before, b.before}].direct = true;
      return;
    }
    constexpr int kFew = 2;  // pieces: what follows one another
    const bool forward = e.a < e.b;
    const Between& from = forward ? a : b;
    const Between& to = forward ? b : a;
    if (to.before - from.before >= kFew) {
      if (a.nearest() != b.nearest()) tie(e, a.nearest(), b.nearest(), 1, 1);
      return;
    }
    // With a strain u[n] over each piece n, the edge's error is the sum of part[n] u[n]; its square
    // is at most, and if all u are the same exactly, sum(part) sum(part[n] u[n]^2).
    const double whole = to.before - from.before + to.share - from.share;
    for (int n = from.before; n <= to.before; ++n) {
      const double part = (n == to.before ? to.share : 1) - (n == from.before ? from.share : 0);
      if (part > 0) tie(e, forward ? n : n + 1, forward ? n + 1 : n, part * whole, part);
    }
  }
  [[nodiscard]] const Ties& ties() const { return ties_; }

 private:
  void tie(const PoseGraphEdge& e, int a, int b, double square, double part) {
    const Sim3& T_end = fine_.T_world_node[static_cast<std::size_t>(e.b)];
    const Sim3& T_b =
        fine_.T_world_node[static_cast<std::size_t>(nodes_[static_cast<std::size_t>(b)])];
    const Vector7d error =
        edge_error(e.T_a_b, fine_.T_world_node[static_cast<std::size_t>(e.a)], T_end);
    const Matrix7d J = sqrt_information(e) * adjoint(T_end.inverse() * T_b);
    Tie& tie = ties_[{a, b}];
    tie.H += square * J.transpose() * J;
    tie.g += part * J.transpose() * (sqrt_information(e) * error);
  }

  const PoseGraph& fine_;
  const std::vector<int>& nodes_;
  std::vector<Between> places_;
  Ties ties_;
};

/// Which ties across the chain are not among the strongest of their later node.
std::vector<std::pair<int, int>> too_many(const Ties& ties, std::size_t most_across) {
  std::map<int, std::vector<std::pair<double, std::pair<int, int>>>> across;
  for (const auto& [ends, tie] : ties)
    if (!tie.direct && std::abs(ends.first - ends.second) > 1)
      across[std::max(ends.first, ends.second)].emplace_back(-tie.H.block<3, 3>(3, 3).trace(),
                                                             ends);
  std::vector<std::pair<int, int>> weak;
  for (auto& [node, order] : across) {
    std::sort(order.begin(), order.end());
    for (std::size_t i = most_across; i < order.size(); ++i) weak.push_back(order[i].second);
  }
  return weak;
}

}  // namespace

std::vector<int> choose_nodes(std::span<const int> strain, std::span<const int> must,
                              std::size_t most) {
  CORVID_CHECK(most >= 4, "a chain needs some nodes");
  std::vector<std::uint8_t> demanded(strain.size(), 0);
  for (const int i : must)
    if (i >= 0 && static_cast<std::size_t>(i) < demanded.size() && most >= must.size() + 4)
      demanded[static_cast<std::size_t>(i)] = 1;
  std::int64_t low = 0, high = std::accumulate(strain.begin(), strain.end(), std::int64_t{1});
  std::vector<int> nodes;
  while (high - low > 1) {  // `high` fits, `low` may not
    const std::int64_t middle = low + (high - low) / 2;
    (fits(strain, demanded, middle, most, nodes) ? high : low) = middle;
  }
  (void)fits(strain, demanded, high, most, nodes);
  return nodes;
}

PoseGraph coarsened(const PoseGraph& fine, const std::vector<int>& nodes, std::size_t most_across) {
  CORVID_CHECK(!nodes.empty() && nodes.front() == 0 &&
                   nodes.back() + 1 == static_cast<int>(fine.T_world_node.size()),
               "the chain's ends are nodes");
  PoseGraph coarse;
  for (const int i : nodes) {
    coarse.T_world_node.push_back(fine.T_world_node[static_cast<std::size_t>(i)]);
    coarse.fixed.push_back(fine.fixed[static_cast<std::size_t>(i)]);
  }
  Projection projection(fine, nodes);
  for (const PoseGraphEdge& e : fine.edges)
    if (usable(e)) projection.add(e);
  Ties ties = projection.ties();
  for (const auto& ends : too_many(ties, most_across)) ties.erase(ends);
  for (const auto& [ends, tie] : ties) {
    const Eigen::LLT<Matrix7d> llt(tie.H);
    const Sim3& T_a = coarse.T_world_node[static_cast<std::size_t>(ends.first)];
    const Sim3& T_b = coarse.T_world_node[static_cast<std::size_t>(ends.second)];
    PoseGraphEdge e{ends.first, ends.second, T_a.inverse() * T_b * Sim3::exp(-llt.solve(tie.g))};
    e.sqrt_information = Matrix7d(llt.matrixU());
    coarse.edges.push_back(e);
  }
  return coarse;
}

void spread(const PoseGraph& coarse, const std::vector<int>& nodes, PoseGraph& fine) {
  CORVID_CHECK(coarse.T_world_node.size() == nodes.size(), "one position per node");
  std::vector<Sim3> moved;  // world to world
  for (std::size_t n = 0; n < nodes.size(); ++n)
    moved.push_back(coarse.T_world_node[n] *
                    fine.T_world_node[static_cast<std::size_t>(nodes[n])].inverse());
  for (std::size_t n = 0; n + 1 < nodes.size(); ++n) {
    const Vector7d step = (moved[n].inverse() * moved[n + 1]).log();
    for (int i = nodes[n] + 1; i < nodes[n + 1]; ++i) {
      const double share = static_cast<double>(i - nodes[n]) / (nodes[n + 1] - nodes[n]);
      Sim3& T = fine.T_world_node[static_cast<std::size_t>(i)];
      T = moved[n] * Sim3::exp(share * step) * T;
    }
  }
  for (std::size_t n = 0; n < nodes.size(); ++n)
    fine.T_world_node[static_cast<std::size_t>(nodes[n])] = coarse.T_world_node[n];
}

}  // namespace corvid
