#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "corvid/ports.h"
#include "io/calibration.h"

namespace corvid {

struct ImageEntry {
  std::string path;
  std::int64_t time_ns = 0;
  std::string name;
  std::optional<Pose> T_world_camera;    ///< true pose of this image
  std::shared_ptr<const Camera> camera;  ///< where every image has its own; else null
};

/// What a format's reader makes of a folder: the images in their order and what is known of them.
/// No image is opened by a reader (EXIF heads aside).
struct ImageList {
  std::string kind;
  std::vector<ImageEntry> entries;
  std::optional<Calibration> calibration;  ///< empty: EXIF or a guess, unless the entries say it
  std::string calibration_path;            ///< for messages
  /// Of `calibration` and the entries' cameras. `exif` also stands for a maker's nominal values.
  IntrinsicsOrigin origin = IntrinsicsOrigin::calibration;
  Trajectory truth;  ///< where truth has its own times; else the entries' poses are it
  bool stills = false;
  bool has_depth = false;
  std::vector<std::string> notes;
  std::vector<std::string> skipped;  ///< rows of the list that name no image, one message each
};

}  // namespace corvid
