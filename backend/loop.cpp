#include "backend/loop.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iterator>

#include "backend/coarse_graph.h"
#include "backend/map_edit.h"

namespace corvid {
namespace {

constexpr std::size_t kNeighbours = 6;
constexpr int kLeastShared = 15;  ///< landmarks of neighbours

/// Keyframes that see the same landmarks.
class Covisibility {
 public:
  /// @param most_views  of a landmark before a keyframe, the newest, that count.
  Covisibility(const MapData& map, std::size_t most_views)
      : map_(map), most_views_(most_views), shared_(map.keyframes.size(), 0) {}

  /// Keyframes before k that share the most landmarks with it, the best kNeighbours of those with
  /// at least kLeastShared.
  [[nodiscard]] std::vector<int> neighbours(int k) {
    std::vector<int> others;
    for (const TrackId id : map_.keyframes[static_cast<std::size_t>(k)].tracks) {
      const auto it = map_.tracks.find(id);
      if (it == map_.tracks.end() || !it->second.landmark) continue;
      const auto& views = it->second.views;
      const auto here =
          std::lower_bound(views.begin(), views.end(), k,
                           [](const KeyframeView& v, int other) { return v.keyframe < other; });
      const auto before = static_cast<std::size_t>(here - views.begin());
      for (std::size_t i = before - std::min(before, most_views_); i < before; ++i)
        if (shared_[static_cast<std::size_t>(views[i].keyframe)]++ == 0)
          others.push_back(views[i].keyframe);
    }
    std::vector<std::pair<int, int>> order;
    for (const int other : others) {
      const int n = std::exchange(shared_[static_cast<std::size_t>(other)], 0);
      if (n >= kLeastShared) order.emplace_back(-n, other);
    }
    std::sort(order.begin(), order.end());
    std::vector<int> best;
    for (std::size_t i = 0; i < std::min(kNeighbours, order.size()); ++i)
      best.push_back(order[i].second);
    return best;
  }

 private:
  const MapData& map_;
  std::size_t most_views_;
  std::vector<int> shared_;
};

Sim3 as_similarity(const Pose& T) { return {1, T.rotation(), T.translation()}; }

/// What drifts between two keyframes: the distance by 1 %, the direction and the scale little.
/// @param times  so many edges of the kind it stands for.
PoseGraphEdge edge(int a, int b, const Sim3& T_a_b, double times = 1) {
  constexpr double kShare = 0.01, kLeast = 1e-4, kRotation_rad = 1e-3, kLogScale = 5e-3;
  const double root = std::sqrt(times);
  return {a,
          b,
          T_a_b,
          std::max(kLeast, kShare * T_a_b.translation().norm()) / root,
          kRotation_rad / root,
          kLogScale / root};
}

/// Whether at least kLeastShared tracks were followed from one keyframe to the other.
bool follow_each_other(const MapKeyframe& a, const MapKeyframe& b) {
  int shared = 0;
  auto i = a.tracks.begin(), k = b.tracks.begin();
  while (i != a.tracks.end() && k != b.tracks.end() && shared < kLeastShared) {
    if (*i < *k) {
      ++i;
    } else if (*k < *i) {
      ++k;
    } else {
      ++shared, ++i, ++k;
    }
  }
  return shared >= kLeastShared;
}

/// Nodes for a long chain: all keyframes near the loop's ends and the newest one, where the next
/// frames will be, and those between which the camera was lost; the others are far between.
std::vector<int> nodes_for(const MapData& map, const std::vector<int>& keyframes, int query,
                           int reference, std::size_t most_nodes) {
  constexpr int kFine = 40, kNear = 30, kLost = 1000;
  const int last = static_cast<int>(keyframes.size()) - 1;
  std::vector<int> strain;
  for (int i = 0; i < last; ++i) {
    const auto& a = map.keyframes[static_cast<std::size_t>(keyframes[static_cast<std::size_t>(i)])];
    const auto& b =
        map.keyframes[static_cast<std::size_t>(keyframes[static_cast<std::size_t>(i) + 1])];
    const auto near = [&](int end) { return std::abs(i - end) < kNear; };
    strain.push_back(1);
    if (near(query) || near(reference) || near(last)) strain.back() = kFine;
    if (!follow_each_other(a, b)) strain.back() = kLost;
  }
  return choose_nodes(strain, std::vector<int>{query, reference}, most_nodes);
}

/// How many of the keyframes from one node to the next are asked for their neighbours, 1 of so
/// many; all where `all`.
int stride_of(int length, bool all) {
  constexpr int kAsked = 2;
  return all ? 1 : (length + kAsked - 1) / kAsked;
}

}  // namespace

LoopGraph loop_graph(const MapData& map, int query, int reference, const Sim3& T_world_query,
                     std::size_t most_nodes) {
  LoopGraph out;
  PoseGraph& graph = out.fine;
  const int segment = map.keyframes[static_cast<std::size_t>(query)].segment;
  std::vector<int> node_of(map.keyframes.size(), -1);
  for (std::size_t k = 0; k < map.keyframes.size(); ++k) {
    if (map.keyframes[k].segment != segment || map.keyframes[k].host) continue;
    node_of[k] = static_cast<int>(out.keyframes.size());
    out.keyframes.push_back(static_cast<int>(k));
    graph.T_world_node.push_back(as_similarity(map.keyframes[k].T_world_camera));
  }
  const int size = static_cast<int>(out.keyframes.size());
  graph.fixed.assign(out.keyframes.size(), 0);
  graph.fixed.front() = 1;
  const auto node = [&](int k) { return node_of[static_cast<std::size_t>(k)]; };
  const auto add = [&](int a, int b, const Sim3& T_world_b, double times) {
    graph.edges.push_back(
        edge(a, b, graph.T_world_node[static_cast<std::size_t>(a)].inverse() * T_world_b, times));
  };
  const bool whole = out.keyframes.size() <= most_nodes;
  if (whole) {
    for (int i = 0; i < size; ++i) out.nodes.push_back(i);
  } else {
    out.nodes = nodes_for(map, out.keyframes, node(query), node(reference), most_nodes);
  }
  constexpr std::size_t kMostViews = 60;
  Covisibility covisibility(map, whole ? map.keyframes.size() : kMostViews);
  for (std::size_t n = 1; n < out.nodes.size(); ++n) {
    const int length = out.nodes[n] - out.nodes[n - 1], stride = stride_of(length, whole);
    bool tied = false;
    for (int i = out.nodes[n]; i > out.nodes[n - 1]; i -= stride) {
      const Sim3& T = graph.T_world_node[static_cast<std::size_t>(i)];
      const int times = std::min(stride, i - out.nodes[n - 1]);
      for (const int k : covisibility.neighbours(out.keyframes[static_cast<std::size_t>(i)])) {
        if (node(k) < 0) continue;
        add(node(k), i, T, times);
        tied = tied || node(k) == i - 1;
      }
    }
    if (tied) continue;
    // Between them the camera was lost: only so that the graph hangs together.
    constexpr double kLoose = 1e-4;
    add(out.nodes[n - 1], out.nodes[n], graph.T_world_node[static_cast<std::size_t>(out.nodes[n])],
        kLoose);
  }
  add(node(reference), node(query), T_world_query, 1);
  return out;
}

bool bend_loop(MapData& map, std::vector<FrameRecord>& frames, int query, int reference,
               const Sim3& T_world_query, int threads, std::size_t most_nodes) {
  constexpr int kIterations = 20, kCoarseIterations = 10;
  constexpr std::size_t kAcross = 2;
  LoopGraph graph = loop_graph(map, query, reference, T_world_query, most_nodes);
  PoseGraph& fine = graph.fine;
  if (graph.nodes.size() == graph.keyframes.size()) {
    if (!optimise(fine, kIterations, threads).ok) return false;
  } else {
    PoseGraph coarse = coarsened(fine, graph.nodes, kAcross);
    if (!optimise(coarse, kCoarseIterations, threads).ok) return false;
    spread(coarse, graph.nodes, fine);
  }
  std::vector<Sim3> moved;
  for (const MapKeyframe& k : map.keyframes) moved.push_back(as_similarity(k.T_world_camera));
  for (std::size_t i = 0; i < graph.keyframes.size(); ++i)
    moved[static_cast<std::size_t>(graph.keyframes[i])] = fine.T_world_node[i];
  move_keyframes(map, frames, moved);
  return true;
}

}  // namespace corvid
