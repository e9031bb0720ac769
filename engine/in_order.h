#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <stop_token>
#include <string_view>

#include "corvid/ports.h"

namespace corvid {

/// Takes frames from a source and refuses those that are not newer than the one before: a frame
/// that comes twice, or after its successor. Refused frames are counted as skipped, blind ones as
/// nothing.
///
/// A time that leaps ahead by more than 10 s must be confirmed by the next frame, which such a
/// frame waits for: taken at its word, one wrong time would make all that follow too late.
class InOrder {
 public:
  /// @param source  outlives this.
  explicit InOrder(FrameSource& source) : source_(source) {}
  /// As FrameSource::next(). Errors besides the source's: corrupt, when the clock went back for
  /// good: ten frames in a row whose times rise are each more than 10 s too late. Times of poses
  /// rise, and those of positions are compared with them, so a new clock needs a new run.
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop);
  /// The source's counts, those refused here moved from the delivered to the skipped ones.
  [[nodiscard]] SourceCounts counts() const;

 private:
  [[nodiscard]] Expected<FramePtr> take(const std::stop_token& stop);
  [[nodiscard]] FramePtr accept(FramePtr frame);
  void refuse(const Frame& frame, std::string_view why);

  FrameSource& source_;
  std::optional<std::int64_t> newest_ns_;
  FramePtr leapt_;                            ///< waits for the frame after it
  std::optional<Expected<FramePtr>> taken_;   ///< that frame, when it has confirmed leapt_
  std::optional<std::int64_t> last_late_ns_;  ///< of the frames in a row that came far too late
  std::size_t late_in_a_row_ = 0;
  SourceCounts refused_;  ///< skipped and messages only
};

}  // namespace corvid
