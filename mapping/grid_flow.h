#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <stop_token>
#include <vector>

#include "mapping/crust_blocks.h"

namespace corvid {

/// Maximum flow and minimum cut of a 6-connected grid of which only a part, a thin crust, are
/// nodes.
///
/// Incremental breadth first search (Goldberg, Hed, Kaplan, Tarjan and Werneck, "Maximum flows by
/// incremental breadth-first search", ESA 2011): two trees of shortest residual paths, from the
/// source and from the sink, grow level by level; where they meet, flow is pushed and what it cuts
/// off is hung in again at the lowest level that offers a parent. The worst case is polynomial.
/// There is no graph of pointers: voxels lie in blocks of 8x8x8, made where there are nodes, and a
/// neighbour is found by arithmetic or by its block's table of six. 21 bytes per voxel of a block.
///
/// Capacities are integers, so the flow is exact and the cut is the one nearest to the source,
/// whatever the order of the work: deterministic.
class GridFlow {
 public:
  /// Of a link, both directions together.
  static constexpr int kMaxLink = 65535;
  /// Bytes of memory per voxel of a block.
  static constexpr std::size_t kVoxelBytes = 21;

  /// @param blocks  where the nodes are; outlives the flow.
  explicit GridFlow(const CrustBlocks& blocks);

  /// Capacity from the source (positive) or to the sink (negative); both together would only add
  /// the smaller one to the flow. @pre place >= CrustBlocks::kNone; set before solve(), here and
  /// below.
  void set_terminal(std::uint32_t place, int capacity) { excess_[place] = capacity; }
  /// Capacities between a voxel and the next one along an axis. Links to voxels without a block are
  /// dropped. @pre not negative, not more than kMaxLink together.
  void set_link(std::uint32_t place, int axis, int forward, int backward);

  /// Finds the maximum flow; to be called once.
  /// @return the flow; negative if it was asked to stop.
  std::int64_t solve(const std::stop_token& stop = {});

  /// After solve(): whether a voxel is on the source's side of the minimum cut, that is, whether
  /// the source still reaches it. Voxels that nothing reaches are not.
  [[nodiscard]] bool on_source_side(std::uint32_t place) const { return level_[place] > 0; }

 private:
  // A tree is named by the sign of its levels: 1 hangs on the source, -1 on the sink.
  static constexpr std::uint8_t kRoot = 6, kNoParent = 7;
  struct Tree {
    std::vector<std::uint32_t> next;                  ///< to grow in the next pass
    std::vector<std::uint32_t> now;                   ///< that are growing
    std::vector<std::vector<std::uint32_t>> orphans;  ///< by level
    int lowest_orphan = 0;
    int level = 1;  ///< of the voxels in `next`
  };

  template <int kSide>
  [[nodiscard]] Tree& tree() {
    return kSide > 0 ? source_ : sink_;
  }
  /// What can still flow between a voxel of a tree and its neighbour, away from the root.
  template <int kSide>
  [[nodiscard]] std::uint16_t outward(std::uint32_t v, int direction, std::uint32_t w) const {
    return kSide > 0 ? residual_[static_cast<std::size_t>(direction)][v]
                     : residual_[static_cast<std::size_t>(direction ^ 1)][w];
  }
  template <int kSide>
  [[nodiscard]] std::uint16_t inward(std::uint32_t v, int direction, std::uint32_t w) const {
    return outward<-kSide>(v, direction, w);
  }

  void plant();
  template <int kSide>
  void grow();
  template <int kSide>
  void grow_from(std::uint32_t v);
  void augment(std::uint32_t from, std::uint32_t to, int direction);
  template <int kSide>
  [[nodiscard]] int bottleneck(std::uint32_t v, int limit) const;
  template <int kSide>
  void push_along(std::uint32_t v, int amount);
  template <int kSide>
  void orphan(std::uint32_t v);
  template <int kSide>
  void adopt_orphans();
  template <int kSide>
  void adopt(std::uint32_t v, int level);

  const CrustBlocks& blocks_;
  std::array<std::vector<std::uint16_t>, 6> residual_;  ///< by direction, away from the voxel
  std::vector<std::int32_t> excess_;  ///< left of the capacity from the source or to the sink
  std::vector<std::int32_t> level_;   ///< distance from the root, from 1 on; sign: tree; 0: free
  std::vector<std::uint8_t> parent_;  ///< direction, kRoot or kNoParent
  Tree source_, sink_;
  std::int64_t flow_ = 0;
};

}  // namespace corvid
