#pragma once

#include <vector>

#include "corvid/archive.h"

namespace corvid::testing {

/// An archive in memory, which can be told to fail.
class MemoryArchive : public Archive {
 public:
  Expected<Slot> put(std::span<const std::byte> bytes) override {
    if (full) return fail(ErrorCode::io, "no room");
    kept.emplace_back(bytes.begin(), bytes.end());
    return Slot{kept.size() - 1, bytes.size()};
  }
  Expected<std::vector<std::byte>> get(const Slot& slot) const override {
    ++reads;
    if (broken) return fail(ErrorCode::io, "cannot be read");
    return kept.at(slot.offset);
  }
  void drop(const Slot& slot) override { kept.at(slot.offset).clear(); }

  std::vector<std::vector<std::byte>> kept;
  mutable int reads = 0;
  bool full = false, broken = false;
};

}  // namespace corvid::testing
