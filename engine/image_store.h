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

  /// Puts away what exceeds the budget. After a failure all stays in memory until there are 50
  /// more keyframes: the disk may have room again by then.
  void trim(const MapSnapshot& map);
  /// Why pictures stayed in memory, or did so for a while; empty if nothing failed.
  [[nodiscard]] const std::optional<Error>& failure() const { return failure_; }

 private:
  std::shared_ptr<Archive> archive_;
  std::size_t budget_bytes_;
  std::size_t next_try_ = 0;  ///< keyframes
  std::optional<Error> failure_;
};

}  // namespace corvid
