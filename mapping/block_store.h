#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <unordered_map>
#include <vector>

#include "corvid/archive.h"
#include "mapping/slices.h"
#include "mapping/voxel_block.h"

namespace corvid {

/// How much a voxel map may take up.
struct VoxelBudget {
  std::size_t memory_bytes = 192UL << 20;   ///< of blocks in memory; at least kMinBlocks are kept
  std::uint64_t archive_bytes = 4UL << 30;  ///< of blocks in the archive
};

/// Voxel blocks by their index, more of them than memory holds: when the budget is spent, those
/// that were asked for the longest time ago go to the archive and come back when asked for. Where
/// there is no archive, or no room in it, they are lost, and counted.
///
/// About 100 bytes per block stay in memory wherever it lies. Not thread-safe. Which blocks are in
/// memory depends on nothing but the calls.
class BlockStore {
 public:
  /// Pointers stay valid while at most so many other blocks are asked for or made.
  static constexpr std::size_t kMinBlocks = 64, kPointersValid = 32;

  /// @param archive    may be null.
  /// @param slice_end  called now and then while blocks are put away.
  BlockStore(const VoxelBudget& budget, std::shared_ptr<Archive> archive, SliceEnd slice_end = {});
  ~BlockStore();
  BlockStore(BlockStore&& other) noexcept = default;
  BlockStore& operator=(BlockStore&&) = delete;
  BlockStore(const BlockStore&) = delete;
  BlockStore& operator=(const BlockStore&) = delete;

  /// Read back if need be; nullptr if there is none. Whoever writes to it calls changed().
  [[nodiscard]] VoxelBlock* find(const BlockIndex& index);
  void changed(const BlockIndex& index);
  /// An empty block. @pre there is none yet.
  VoxelBlock& make(const BlockIndex& index);
  void erase(const BlockIndex& index);

  /// Differs for every block that was ever made; nothing if there is none. Reads nothing back.
  [[nodiscard]] std::optional<std::uint32_t> serial(const BlockIndex& index) const;
  [[nodiscard]] bool contains(const BlockIndex& index) const { return blocks_.contains(index); }
  /// In no order.
  [[nodiscard]] std::vector<BlockIndex> indices() const;
  [[nodiscard]] std::size_t size() const { return blocks_.size(); }
  [[nodiscard]] std::size_t in_memory() const { return in_memory_; }
  /// Blocks lost since the last call.
  [[nodiscard]] std::vector<BlockIndex> take_lost();
  [[nodiscard]] std::uint64_t lost() const { return lost_count_; }

 private:
  struct Held {
    std::unique_ptr<VoxelBlock> block;  ///< null: in the archive
    std::optional<Archive::Slot> slot;  ///< of a copy that is still true
    std::uint64_t last_use = 0;
    std::uint32_t serial = 0;
  };
  using Map = std::unordered_map<BlockIndex, Held, BlockIndexHash>;

  void make_room();
  bool put_away(Held& held);
  void forget_copy(Held& held);
  void lose(Map::iterator it, const Error& why);

  std::size_t capacity_;
  std::uint64_t archive_budget_bytes_;
  std::shared_ptr<Archive> archive_;
  SliceEnd slice_end_;
  Map blocks_;
  std::size_t in_memory_ = 0;
  std::uint64_t archived_bytes_ = 0, uses_ = 0, lost_count_ = 0;
  std::uint32_t next_serial_ = 1;
  std::vector<BlockIndex> lost_;
};

}  // namespace corvid
