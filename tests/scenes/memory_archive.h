#pragma once

#include <map>
#include <mutex>
#include <optional>
#include <vector>

#include "corvid/archive.h"

namespace corvid::testing {

/// An archive in memory, which can be told to fail.
class MemoryArchive : public Archive {
 public:
  Expected<Slot> put(std::span<const std::byte> bytes) override {
    const std::lock_guard lock(mutex_);
    if (room && kept.size() >= *room) return fail(ErrorCode::io, "no room");
    const Slot slot{next_++, bytes.size()};
    kept[slot.offset].assign(bytes.begin(), bytes.end());
    return slot;
  }
  Expected<std::vector<std::byte>> get(const Slot& slot) const override {
    const std::lock_guard lock(mutex_);
    ++reads;
    if (broken) return fail(ErrorCode::io, "cannot be read");
    return kept.at(slot.offset);
  }
  void drop(const Slot& slot) override {
    const std::lock_guard lock(mutex_);
    kept.erase(slot.offset);
  }

  std::optional<std::size_t> room;  ///< for so many
  bool broken = false;
  mutable int reads = 0;
  std::map<std::uint64_t, std::vector<std::byte>> kept;

 private:
  mutable std::mutex mutex_;
  std::uint64_t next_ = 0;
};

}  // namespace corvid::testing
