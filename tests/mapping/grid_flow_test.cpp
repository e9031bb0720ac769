#include "mapping/grid_flow.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>
#include <vector>

#include "oracle/max_flow.h"

namespace corvid {
namespace {

/// A problem written down: what GridFlow and the oracle are both made from.
struct Problem {
  Eigen::Vector3i size;
  BitGrid nodes;
  std::vector<Eigen::Vector3i> voxels;
  std::vector<int> terminal;
  struct Link {
    Eigen::Vector3i from;
    int axis = 0, forward = 0, backward = 0;
  };
  std::vector<Link> links;
};

template <class Voxels, class Terminal, class Capacity>
Problem make_problem(const Eigen::Vector3i& size, Voxels&& is_node, Terminal&& terminal,
                     Capacity&& capacity) {
  Problem p{size, BitGrid(size), {}, {}, {}};
  for (int z = 0; z < size.z(); ++z) {
    for (int y = 0; y < size.y(); ++y) {
      for (int x = 0; x < size.x(); ++x) {
        if (!is_node(Eigen::Vector3i(x, y, z))) continue;
        p.nodes.set({x, y, z});
        p.voxels.emplace_back(x, y, z);
        p.terminal.push_back(terminal(Eigen::Vector3i(x, y, z)));
      }
    }
  }
  for (const Eigen::Vector3i& v : p.voxels) {
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3i w = v + Eigen::Vector3i::Unit(axis);
      if (p.nodes.contains(w) && p.nodes.test(w)) {
        p.links.push_back({v, axis, capacity(), capacity()});
      }
    }
  }
  return p;
}

/// Both solvers agree in the flow and in every label; the cut's cost is the flow.
void check(const Problem& p) {
  const CrustBlocks blocks(p.nodes);
  GridFlow grid(blocks);
  const int source = 0, sink = 1;
  std::vector<int> name(static_cast<std::size_t>(p.size.prod()), -1);
  const auto at = [&](const Eigen::Vector3i& v) {
    return static_cast<std::size_t>(v.x() + p.size.x() * (v.y() + p.size.y() * v.z()));
  };
  for (std::size_t i = 0; i < p.voxels.size(); ++i) {
    name[at(p.voxels[i])] = static_cast<int>(i) + 2;
  }
  oracle::MaxFlow textbook(static_cast<int>(p.voxels.size()) + 2);
  for (std::size_t i = 0; i < p.voxels.size(); ++i) {
    const std::uint32_t index = blocks.place(p.voxels[i]);
    ASSERT_GE(index, CrustBlocks::kNone);
    ASSERT_EQ(blocks.voxel(index), p.voxels[i]);
    grid.set_terminal(index, p.terminal[i]);
    if (p.terminal[i] > 0) textbook.add(source, static_cast<int>(i) + 2, p.terminal[i]);
    if (p.terminal[i] < 0) textbook.add(static_cast<int>(i) + 2, sink, -p.terminal[i]);
  }
  for (const auto& l : p.links) {
    grid.set_link(blocks.place(l.from), l.axis, l.forward, l.backward);
    textbook.add(name[at(l.from)], name[at(l.from + Eigen::Vector3i::Unit(l.axis))], l.forward,
                 l.backward);
  }
  const std::int64_t flow = grid.solve();
  ASSERT_EQ(flow, textbook.solve(source, sink));
  const std::vector<bool> side = textbook.source_side(source);
  const auto ours = [&](const Eigen::Vector3i& v) { return grid.on_source_side(blocks.place(v)); };
  std::int64_t cut = 0;
  for (std::size_t i = 0; i < p.voxels.size(); ++i) {
    ASSERT_EQ(ours(p.voxels[i]), side[i + 2]) << p.voxels[i].transpose();
    if (ours(p.voxels[i]) != (p.terminal[i] > 0)) cut += std::abs(p.terminal[i]);
  }
  for (const auto& l : p.links) {
    const bool a = ours(l.from), b = ours(l.from + Eigen::Vector3i::Unit(l.axis));
    if (a && !b) cut += l.forward;
    if (b && !a) cut += l.backward;
  }
  EXPECT_EQ(cut, flow) << "the minimum cut costs what the maximum flow carries";
}

using Random = std::mt19937;
int pick(Random& random, int low, int high) {
  return std::uniform_int_distribution<int>(low, high)(random);
}

TEST(GridFlow, AgreesWithTheTextbookOnRandomGrids) {
  for (unsigned seed = 0; seed < 300; ++seed) {
    Random random(seed);
    const Eigen::Vector3i size(pick(random, 1, 11), pick(random, 1, 10), pick(random, 1, 10));
    const int filled = pick(random, 30, 100), with_terminal = pick(random, 2, 100);
    const int largest = pick(random, 1, 4) == 1 ? 1 : pick(random, 2, 60);
    const int empty_links = pick(random, 0, 70);
    SCOPED_TRACE(seed);
    check(make_problem(
        size, [&](const Eigen::Vector3i&) { return pick(random, 1, 100) <= filled; },
        [&](const Eigen::Vector3i&) {
          return pick(random, 1, 100) <= with_terminal ? pick(random, -3 * largest, 3 * largest)
                                                       : 0;
        },
        [&] { return pick(random, 1, 100) <= empty_links ? 0 : pick(random, 0, largest); }));
  }
}

TEST(GridFlow, AgreesWithTheTextbookOnSlabsBetweenSourceAndSink) {
  // Like a crust: sources on one side, sinks on the other, cheap links in between, holes in them.
  for (unsigned seed = 0; seed < 12; ++seed) {
    Random random(1000 + seed);
    const Eigen::Vector3i size(18, 13, 10);
    const int cheap = pick(random, 1, 5), dear = pick(random, 50, 4000);
    SCOPED_TRACE(seed);
    check(make_problem(
        size, [&](const Eigen::Vector3i&) { return true; },
        [&](const Eigen::Vector3i& v) {
          return v.z() < 1 ? dear : v.z() > 8 ? -dear : pick(random, -2, 3);
        },
        [&] { return pick(random, 0, 2) == 0 ? dear : cheap; }));
  }
}

TEST(GridFlow, LongDetoursAreFollowed) {
  // A snake through the box: the only way from one end to the other.
  const Eigen::Vector3i size(17, 9, 9);
  const auto snake = [&](const Eigen::Vector3i& v) {
    if (v.y() % 2 == 0 && v.z() % 2 == 0) return true;
    if (v.z() % 2 == 0) return v.x() == ((v.y() / 2) % 2 == 0 ? 16 : 0);
    return v.x() == 0 && v.y() == ((v.z() / 2) % 2 == 0 ? 8 : 0);
  };
  Random random(3);
  check(make_problem(
      size, snake,
      [&](const Eigen::Vector3i& v) {
        return v.isZero() ? 100 : v.z() == 8 && v.y() == 8 ? -9 : 0;
      },
      [&] { return pick(random, 20, 60); }));
}

TEST(GridFlow, DegenerateGridsHaveDefinedAnswers) {
  {
    const CrustBlocks none((BitGrid(Eigen::Vector3i(0, 0, 0))));
    EXPECT_EQ(GridFlow(none).solve(), 0);
    EXPECT_EQ(none.place({0, 0, 0}), 0U);
  }
  {
    const CrustBlocks empty((BitGrid(Eigen::Vector3i(20, 5, 3))));
    EXPECT_EQ(empty.blocks(), 1U);
    GridFlow flow(empty);
    EXPECT_EQ(flow.solve(), 0);
    EXPECT_FALSE(flow.on_source_side(empty.place({1, 1, 1})));
  }
  const auto all = [](const Eigen::Vector3i&) { return true; };
  const Eigen::Vector3i size(9, 9, 9);
  const auto nothing = [](const Eigen::Vector3i&) { return 0; };
  check(make_problem(size, all, nothing, [] { return 5; }));
  check(make_problem(
      size, all, [](const Eigen::Vector3i&) { return 7; }, [] { return 5; }));
  check(make_problem(
      size, all, [](const Eigen::Vector3i&) { return -7; }, [] { return 5; }));
  check(make_problem(
      {1, 1, 1}, all, [](const Eigen::Vector3i&) { return 3; }, [] { return 5; }));
  // The largest capacities that fit.
  check(make_problem(
      size, all,
      [](const Eigen::Vector3i& v) { return (v.x() + v.y()) % 3 == 0 ? 2000000000 : -2000000000; },
      [] { return GridFlow::kMaxLink / 2; }));
}

TEST(GridFlow, BlocksAreOnlyWhereThereAreNodes) {
  BitGrid nodes(Eigen::Vector3i(70, 64, 64));
  nodes.set({0, 0, 0});
  nodes.set({69, 63, 63});
  const CrustBlocks blocks(nodes);
  GridFlow grid(blocks);
  EXPECT_EQ(blocks.blocks(), 3U);
  EXPECT_LT(blocks.place({30, 30, 30}), CrustBlocks::kNone);
  EXPECT_EQ(blocks.place({-1, 0, 0}), 0U);
  EXPECT_EQ(blocks.place({0, 0, 64}), 0U);
  grid.set_link(blocks.place({0, 0, 0}), 0, 4,
                4);  // to a voxel of its block that is no node: unused
  grid.set_terminal(blocks.place({0, 0, 0}), 9);
  grid.set_terminal(blocks.place({69, 63, 63}), -9);
  EXPECT_EQ(grid.solve(), 0);
}

TEST(GridFlow, StopsWhenAsked) {
  BitGrid nodes(Eigen::Vector3i(4, 4, 4));
  nodes.set({1, 1, 1});
  const CrustBlocks blocks(nodes);
  GridFlow grid(blocks);
  grid.set_terminal(blocks.place({1, 1, 1}), 9);
  std::stop_source stop;
  stop.request_stop();
  EXPECT_LT(grid.solve(stop.get_token()), 0);
}

TEST(BitGrid, SpreadsToTheVoxelsWithinFour) {
  // The middle, corners, and the seam between two words.
  const Eigen::Vector3i size(131, 12, 11);
  const std::vector<Eigen::Vector3i> points{{0, 0, 0}, {130, 11, 10}, {63, 6, 5}, {100, 3, 9}};
  BitGrid grid(size);
  for (const auto& p : points) grid.set(p);
  EXPECT_EQ(grid.count(), points.size());
  const BitGrid near = grid.within_4();
  std::size_t n = 0;
  for (int z = 0; z < size.z(); ++z) {
    for (int y = 0; y < size.y(); ++y) {
      for (int x = 0; x < size.x(); ++x) {
        double distance = 1e9;
        for (const auto& p : points) {
          distance = std::min(distance, (p - Eigen::Vector3i(x, y, z)).cast<double>().norm());
        }
        const bool is_near = near.test({x, y, z});
        n += is_near;
        if (distance <= 4 || distance > 4.9) {
          EXPECT_EQ(is_near, distance <= 4) << x << " " << y << " " << z;
        }
      }
    }
  }
  EXPECT_EQ(near.count(), n) << "no bits beyond the rows' ends";
  EXPECT_EQ(BitGrid(Eigen::Vector3i(0, 3, 3)).within_4().count(), 0U);
}

}  // namespace
}  // namespace corvid
