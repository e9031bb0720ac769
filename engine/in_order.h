#pragma once

#include <cstdint>
#include <optional>
#include <stop_token>

#include "corvid/ports.h"

namespace corvid {

/// Takes frames from a source and refuses those that are not newer than the one before: a frame
/// that comes twice, or after its successor. Refused frames are counted as skipped.
class InOrder {
 public:
  /// @param source  outlives this.
  explicit InOrder(FrameSource& source) : source_(source) {}
  /// As FrameSource::next().
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop);
  /// The source's counts, those refused here moved from the delivered to the skipped ones.
  [[nodiscard]] SourceCounts counts() const;

 private:
  FrameSource& source_;
  std::optional<std::int64_t> newest_ns_;
  SourceCounts refused_;  ///< skipped and messages only
};

}  // namespace corvid
