#include "mapping/block_store.h"

#include <algorithm>
#include <cstring>
#include <span>
#include <type_traits>
#include <utility>

#include "core/check.h"
#include "core/log.h"

namespace corvid {
namespace {

static_assert(std::is_trivially_copyable_v<VoxelBlock>);
constexpr std::size_t kHeldBytes = 128;  // of a block's entry, its allocation included
constexpr int kSliceBlocks = 128;        // put away in about two milliseconds

}  // namespace

BlockStore::BlockStore(const VoxelBudget& budget, std::shared_ptr<Archive> archive,
                       SliceEnd slice_end)
    : capacity_(std::max(kMinBlocks, budget.memory_bytes / (sizeof(VoxelBlock) + kHeldBytes))),
      archive_budget_bytes_(budget.archive_bytes),
      archive_(std::move(archive)),
      slice_end_(std::move(slice_end)) {}

BlockStore::~BlockStore() {
  for (auto& [index, held] : blocks_) forget_copy(held);
}

VoxelBlock* BlockStore::find(const BlockIndex& index) {
  const auto it = blocks_.find(index);
  if (it == blocks_.end()) return nullptr;
  Held& held = it->second;
  held.last_use = ++uses_;
  if (held.block) return held.block.get();
  const auto bytes = archive_->get(*held.slot);
  if (!bytes || bytes->size() != sizeof(VoxelBlock)) {
    lose(it, bytes ? Error{ErrorCode::corrupt, "an archived block has another size", "archive", {}}
                   : bytes.error());
    return nullptr;
  }
  held.block = std::make_unique<VoxelBlock>();
  std::memcpy(static_cast<void*>(held.block.get()), bytes->data(), sizeof(VoxelBlock));
  ++in_memory_;
  make_room();
  return held.block.get();
}

void BlockStore::changed(const BlockIndex& index) {
  const auto it = blocks_.find(index);
  if (it != blocks_.end()) forget_copy(it->second);
}

VoxelBlock& BlockStore::make(const BlockIndex& index) {
  const auto [it, is_new] = blocks_.try_emplace(index);
  CORVID_CHECK(is_new, "the block is there already");
  Held& held = it->second;
  held.block = std::make_unique<VoxelBlock>();
  held.serial = next_serial_++;
  held.last_use = ++uses_;
  VoxelBlock& block = *held.block;
  ++in_memory_;
  make_room();
  return block;
}

void BlockStore::erase(const BlockIndex& index) {
  const auto it = blocks_.find(index);
  if (it == blocks_.end()) return;
  forget_copy(it->second);
  in_memory_ -= it->second.block != nullptr;
  blocks_.erase(it);
}

std::optional<std::uint32_t> BlockStore::serial(const BlockIndex& index) const {
  const auto it = blocks_.find(index);
  if (it == blocks_.end()) return std::nullopt;
  return it->second.serial;
}

std::vector<BlockIndex> BlockStore::indices() const {
  std::vector<BlockIndex> out;
  out.reserve(blocks_.size());
  for (const auto& [index, held] : blocks_) out.push_back(index);
  return out;
}

std::vector<BlockIndex> BlockStore::take_lost() { return std::exchange(lost_, {}); }

void BlockStore::make_room() {
  if (in_memory_ <= capacity_) return;
  // A quarter at once, so that the search for the oldest costs little per block.
  std::vector<std::pair<std::uint64_t, Map::iterator>> oldest;
  for (auto it = blocks_.begin(); it != blocks_.end(); ++it)
    if (it->second.block) oldest.emplace_back(it->second.last_use, it);
  const std::size_t n = in_memory_ - capacity_ + capacity_ / 4;
  std::nth_element(oldest.begin(), oldest.begin() + static_cast<std::ptrdiff_t>(n), oldest.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  oldest.resize(n);
  std::sort(oldest.begin(), oldest.end(),
            [](const auto& a, const auto& b) { return a.first < b.first; });
  Slicer away(slice_end_, kSliceBlocks);
  for (const auto& [use, it] : oldest) {
    away.piece();
    if (!it->second.slot && !put_away(it->second)) {
      continue;
    }
    it->second.block.reset();
    --in_memory_;
  }
  if (in_memory_ <= capacity_) return;
  for (const auto& [use, it] : oldest)
    if (it->second.block)
      lose(it, {ErrorCode::io, "there is no room in the archive", "voxel map",
                "raise mapping.memory_mb or mapping.disk_mb"});
}

bool BlockStore::put_away(Held& held) {
  if (!archive_ || archived_bytes_ + sizeof(VoxelBlock) > archive_budget_bytes_) return false;
  const auto slot = archive_->put(std::as_bytes(std::span(held.block.get(), 1)));
  if (!slot) return false;
  held.slot = *slot;
  archived_bytes_ += sizeof(VoxelBlock);
  return true;
}

void BlockStore::forget_copy(Held& held) {
  if (!held.slot) return;
  archive_->drop(*held.slot);
  held.slot.reset();
  archived_bytes_ -= sizeof(VoxelBlock);
}

void BlockStore::lose(Map::iterator it, const Error& why) {
  if (lost_count_++ == 0) log().warn("mapping: voxel blocks are lost: {}", why.to_string());
  lost_.push_back(it->first);
  forget_copy(it->second);
  in_memory_ -= it->second.block != nullptr;
  blocks_.erase(it);
}

}  // namespace corvid
