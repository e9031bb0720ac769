#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "corvid/error.h"

namespace corvid {

/// Port: what need not stay in memory goes out and comes back, whole and unchanged. Thread-safe;
/// calls may wait for a disk, so no thread that a frame waits for makes one.
class Archive {
 public:
  /// Names what was put away; of no meaning in another archive.
  struct Slot {
    std::uint64_t offset = 0, size = 0;
    bool operator==(const Slot&) const = default;
  };
  virtual ~Archive() = default;
  /// Keeps a copy. Errors: io, if there is no room; then nothing is kept.
  [[nodiscard]] virtual Expected<Slot> put(std::span<const std::byte> bytes) = 0;
  /// What was put there. Errors: io.
  [[nodiscard]] virtual Expected<std::vector<std::byte>> get(const Slot& slot) const = 0;
  /// Gives the slot's room to others. It must not be used again.
  virtual void drop(const Slot& slot) = 0;
};

}  // namespace corvid
