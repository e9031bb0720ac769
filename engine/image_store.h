#pragma once

#include <cstddef>
#include <memory>
#include <optional>

#include "corvid/archive.h"
#include "corvid/map.h"

namespace corvid {

/// Keeps the pictures of the newest keyframes in memory and puts those of older ones away. One
/// owner; calls may wait for a disk.
class ImageStore {
 public:
  /// @param archive  null: everything stays in memory.
  ImageStore(std::shared_ptr<Archive> archive, std::size_t budget_bytes);

  /// Puts away what exceeds the budget. After a failure nothing more is put away.
  void trim(const MapSnapshot& map);
  /// Why pictures stay in memory after all; empty if nothing failed.
  [[nodiscard]] const std::optional<Error>& failure() const { return failure_; }

 private:
  std::shared_ptr<Archive> archive_;
  std::size_t budget_bytes_;
  std::optional<Error> failure_;
};

}  // namespace corvid
