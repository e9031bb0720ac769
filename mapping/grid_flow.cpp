#include "mapping/grid_flow.h"

#include <algorithm>

namespace corvid {

GridFlow::GridFlow(const CrustBlocks& blocks) : blocks_(blocks) {
  for (auto& r : residual_) r.assign(blocks.places(), 0);
  excess_.assign(blocks.places(), 0);
  level_.assign(blocks.places(), 0);
  parent_.assign(blocks.places(), kNoParent);
}

void GridFlow::set_link(std::uint32_t place, int axis, int forward, int backward) {
  const std::uint32_t other = blocks_.neighbour(place, 2 * axis);
  if (place < CrustBlocks::kNone || other < CrustBlocks::kNone) return;
  const auto out = static_cast<std::size_t>(2 * axis);
  residual_[out][place] = static_cast<std::uint16_t>(forward);
  residual_[out + 1][other] = static_cast<std::uint16_t>(backward);
}

std::int64_t GridFlow::solve(const std::stop_token& stop) {
  plant();
  // Once one tree cannot grow any more, the flow is at its maximum; the source's tree grows on to
  // all that it reaches.
  while (!source_.next.empty()) {
    if (stop.stop_requested()) return -1;
    if (!sink_.next.empty() && sink_.next.size() < source_.next.size()) {
      grow<-1>();
    } else {
      grow<1>();
    }
  }
  return flow_;
}

void GridFlow::plant() {
  for (std::uint32_t v = CrustBlocks::kNone; v < excess_.size(); ++v) {
    if (excess_[v] == 0) continue;
    level_[v] = excess_[v] > 0 ? 1 : -1;
    parent_[v] = kRoot;
    (excess_[v] > 0 ? source_ : sink_).next.push_back(v);
  }
  for (Tree* t : {&source_, &sink_}) t->level = 1;
}

template <int kSide>
void GridFlow::grow() {
  Tree& t = tree<kSide>();
  t.now.swap(t.next);
  t.next.clear();
  ++t.level;
  for (std::size_t i = 0; i < t.now.size(); ++i) grow_from<kSide>(t.now[i]);
  t.now.clear();
}

/// Scans the links of one voxel of the level that grows.
template <int kSide>
void GridFlow::grow_from(std::uint32_t v) {
  Tree& t = tree<kSide>();
  const std::int32_t level = kSide * (t.level - 1);
  for (int d = 0; d < 6; ++d) {
    if (level_[v] != level) return;  // moved up, or it was visited before
    const std::uint32_t w = blocks_.neighbour(v, d);
    while (outward<kSide>(v, d, w) > 0) {
      if (level_[w] == 0) {
        level_[w] = level + kSide;
        parent_[w] = static_cast<std::uint8_t>(d ^ 1);
        t.next.push_back(w);
        break;
      }
      if ((level_[w] > 0) == (kSide > 0)) break;
      if (kSide > 0) {
        augment(v, w, d);
      } else {
        augment(w, v, d ^ 1);
      }
      if (level_[v] != level) return;
    }
  }
}

/// Pushes flow along the tree path to `from`, the link and the tree path from `to`.
void GridFlow::augment(std::uint32_t from, std::uint32_t to, int direction) {
  std::uint16_t& link = residual_[static_cast<std::size_t>(direction)][from];
  const int amount = bottleneck<-1>(to, bottleneck<1>(from, link));
  link = static_cast<std::uint16_t>(link - amount);
  std::uint16_t& back = residual_[static_cast<std::size_t>(direction ^ 1)][to];
  back = static_cast<std::uint16_t>(back + amount);
  push_along<1>(from, amount);
  push_along<-1>(to, amount);
  flow_ += amount;
  adopt_orphans<1>();
  adopt_orphans<-1>();
}

template <int kSide>
int GridFlow::bottleneck(std::uint32_t v, int limit) const {
  while (parent_[v] != kRoot) {
    const int d = parent_[v];
    const std::uint32_t p = blocks_.neighbour(v, d);
    limit = std::min<int>(limit, inward<kSide>(v, d, p));
    v = p;
  }
  return std::min(limit, kSide * excess_[v]);
}

template <int kSide>
void GridFlow::push_along(std::uint32_t v, int amount) {
  while (parent_[v] != kRoot) {
    const int d = parent_[v];
    const std::uint32_t p = blocks_.neighbour(v, d);
    std::uint16_t& here = residual_[static_cast<std::size_t>(d)][v];
    std::uint16_t& there = residual_[static_cast<std::size_t>(d ^ 1)][p];
    std::uint16_t& less = kSide > 0 ? there : here;
    std::uint16_t& more = kSide > 0 ? here : there;
    less = static_cast<std::uint16_t>(less - amount);
    more = static_cast<std::uint16_t>(more + amount);
    if (less == 0) orphan<kSide>(v);
    v = p;
  }
  excess_[v] -= kSide * amount;
  if (excess_[v] == 0) orphan<kSide>(v);
}

template <int kSide>
void GridFlow::orphan(std::uint32_t v) {
  Tree& t = tree<kSide>();
  const int level = kSide * level_[v];
  parent_[v] = kNoParent;
  if (t.orphans.size() <= static_cast<std::size_t>(level)) {
    t.orphans.resize(static_cast<std::size_t>(level) + 1);
  }
  t.orphans[static_cast<std::size_t>(level)].push_back(v);
  t.lowest_orphan = std::min(t.lowest_orphan, level);
}

template <int kSide>
void GridFlow::adopt_orphans() {
  Tree& t = tree<kSide>();
  for (; t.lowest_orphan < static_cast<int>(t.orphans.size()); ++t.lowest_orphan) {
    // An adoption makes orphans of higher levels only.
    for (std::size_t i = 0; i < t.orphans[static_cast<std::size_t>(t.lowest_orphan)].size(); ++i) {
      adopt<kSide>(t.orphans[static_cast<std::size_t>(t.lowest_orphan)][i], t.lowest_orphan);
    }
    t.orphans[static_cast<std::size_t>(t.lowest_orphan)].clear();
  }
}

/// Finds a new parent: at the old distance if there is one, otherwise at the least possible one,
/// and its children must look for others; beyond the tree's reach it becomes free.
template <int kSide>
void GridFlow::adopt(std::uint32_t v, int level) {
  Tree& t = tree<kSide>();
  std::array<std::uint32_t, 6> around;
  int nearest = t.level, towards = kNoParent;
  for (int d = 0; d < 6; ++d) {
    const std::uint32_t w = around[static_cast<std::size_t>(d)] = blocks_.neighbour(v, d);
    const int other = kSide * level_[w];
    if (other <= 0 || other >= nearest || inward<kSide>(v, d, w) == 0) continue;
    nearest = other;
    towards = d;
    if (other == level - 1) {
      parent_[v] = static_cast<std::uint8_t>(d);
      return;
    }
  }
  for (int d = 0; d < 6; ++d) {
    const std::uint32_t w = around[static_cast<std::size_t>(d)];
    if (parent_[w] == (d ^ 1) && kSide * level_[w] > 0) orphan<kSide>(w);
  }
  if (towards == kNoParent) {
    level_[v] = 0;
    return;
  }
  parent_[v] = static_cast<std::uint8_t>(towards);
  level_[v] = kSide * (nearest + 1);
  if (nearest + 1 == t.level) t.next.push_back(v);
}

}  // namespace corvid
