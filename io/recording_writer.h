#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "corvid/error.h"
#include "corvid/frame.h"
#include "corvid/pose.h"

namespace corvid {

/// Port: one form in which frames are recorded. What append() has returned from is readable even if
/// the process is killed right after it.
class RecordingWriter {
 public:
  virtual ~RecordingWriter() = default;
  /// The frame's picture as it will lie on the disk. Thread-safe. Errors: io, invalid_argument (a
  /// picture of another size than the recording's).
  [[nodiscard]] virtual Expected<std::vector<std::uint8_t>> encode(const Frame& frame) = 0;
  /// Writes what encode() made of the frame. One call at a time, in the order of the capture times,
  /// which must not be negative and must rise. Errors: io (a full disk), invalid_argument.
  [[nodiscard]] virtual Expected<void> append(const Frame& frame,
                                              std::span<const std::uint8_t> picture) = 0;
  /// encode() and append().
  [[nodiscard]] Expected<void> write(const Frame& frame) {
    const auto picture = encode(frame);
    if (!picture) return tl::unexpected(picture.error());
    return append(frame, *picture);
  }
  /// True poses, where the form has a place for them: false if it has none.
  [[nodiscard]] virtual Expected<bool> write_truth(const Trajectory& truth) = 0;
  /// Writes what makes the recording complete (a video's index). Nothing may be appended after it.
  [[nodiscard]] virtual Expected<void> finish() = 0;
};

}  // namespace corvid
