#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>

#include "corvid/archive.h"
#include "corvid/camera.h"
#include "corvid/ids.h"
#include "corvid/image.h"

namespace corvid {

/// One picture of the camera. Immutable once it is made: it crosses threads as FramePtr.
struct Frame {
  FrameId id;                ///< position in the source, from 0
  std::int64_t time_ns = 0;  ///< capture time
  GreyImage grey;
  ColourImage colour;  ///< empty if the camera is grey
  std::shared_ptr<const Camera> camera;
  std::string name;  ///< file name where there is one; used in messages and exports
  /// Why the camera gives no picture at this time (unplugged, stalled); then both pictures are
  /// empty. Empty for every frame with a picture.
  std::string blind;
};
using FramePtr = std::shared_ptr<const Frame>;

/// What a map keeps of a keyframe's frame: its pictures may have been put away in an archive, and
/// come back for as long as somebody holds them. Thread-safe.
class StoredFrame {
 public:
  /// @pre frame is not null.
  explicit StoredFrame(FramePtr frame);

  const FrameId id;
  const std::int64_t time_ns;
  const std::shared_ptr<const Camera> camera;
  const std::string name;
  const int width_px, height_px;
  const std::size_t image_bytes;  ///< of all its pictures

  /// The frame with its pictures, read back if need be (never on a thread that a frame waits for).
  /// If they cannot be read, without them, and a warning is logged.
  [[nodiscard]] FramePtr load() const;
  /// Lets go of the pictures, which stay in the archive; does nothing if they are there already.
  /// Errors: io; then they stay in memory.
  [[nodiscard]] Expected<void> put_away(std::shared_ptr<Archive> archive) const;
  [[nodiscard]] bool is_away() const;

 private:
  int colour_width_px_, colour_height_px_;
  mutable std::mutex mutex_;
  mutable FramePtr frame_;                   ///< null once put away
  mutable std::weak_ptr<const Frame> loan_;  ///< what load() read back
  mutable std::shared_ptr<Archive> archive_;
  mutable Archive::Slot slot_;
};
using StoredFramePtr = std::shared_ptr<const StoredFrame>;

}  // namespace corvid
