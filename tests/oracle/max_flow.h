#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <vector>

namespace corvid::oracle {

/// Maximum flow by the textbook: shortest augmenting paths, one after the other (Edmonds and Karp,
/// "Theoretical improvements in algorithmic efficiency for network flow problems", 1972).
class MaxFlow {
 public:
  explicit MaxFlow(int nodes) : first_(static_cast<std::size_t>(nodes)) {}

  void add(int from, int to, std::int64_t forward, std::int64_t backward = 0) {
    first_[static_cast<std::size_t>(from)].push_back(arcs_.size());
    arcs_.push_back({to, forward});
    first_[static_cast<std::size_t>(to)].push_back(arcs_.size());
    arcs_.push_back({from, backward});
  }

  std::int64_t solve(int source, int sink) {
    std::int64_t flow = 0;
    while (true) {
      const std::vector<std::size_t> by = reach(source);
      if (by[static_cast<std::size_t>(sink)] == kNone) return flow;
      std::int64_t amount = INT64_MAX;
      for (int v = sink; v != source; v = before(by, v)) {
        amount = std::min(amount, arcs_[by[static_cast<std::size_t>(v)]].left);
      }
      for (int v = sink; v != source; v = before(by, v)) {
        arcs_[by[static_cast<std::size_t>(v)]].left -= amount;
        arcs_[by[static_cast<std::size_t>(v)] ^ 1].left += amount;
      }
      flow += amount;
    }
  }

  /// After solve(): the nodes that the source still reaches.
  [[nodiscard]] std::vector<bool> source_side(int source) const {
    const std::vector<std::size_t> by = reach(source);
    std::vector<bool> out(by.size());
    for (std::size_t i = 0; i < by.size(); ++i) out[i] = by[i] != kNone;
    return out;
  }

 private:
  static constexpr std::size_t kNone = SIZE_MAX, kStart = SIZE_MAX - 1;
  struct Arc {
    int to = 0;
    std::int64_t left = 0;
  };
  [[nodiscard]] int before(const std::vector<std::size_t>& by, int v) const {
    return arcs_[by[static_cast<std::size_t>(v)] ^ 1].to;
  }
  /// Breadth first: the arc by which each node was reached.
  [[nodiscard]] std::vector<std::size_t> reach(int source) const {
    std::vector<std::size_t> by(first_.size(), kNone);
    by[static_cast<std::size_t>(source)] = kStart;
    std::deque<int> queue{source};
    while (!queue.empty()) {
      const int v = queue.front();
      queue.pop_front();
      for (const std::size_t a : first_[static_cast<std::size_t>(v)]) {
        const auto to = static_cast<std::size_t>(arcs_[a].to);
        if (arcs_[a].left <= 0 || by[to] != kNone) continue;
        by[to] = a;
        queue.push_back(arcs_[a].to);
      }
    }
    return by;
  }

  std::vector<Arc> arcs_;  ///< arc 2i+1 is the way back of arc 2i
  std::vector<std::vector<std::size_t>> first_;
};

}  // namespace corvid::oracle
