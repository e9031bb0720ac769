#pragma once

#include <memory>
#include <string>

#include "corvid/error.h"
#include "io/source.h"

namespace corvid {

/// True for a name that ends as video files do.
[[nodiscard]] bool is_video_name(const std::string& name);

/// A video file, decoded by FFmpeg through OpenCV. Times are the container's where they rise, else
/// the frame's number by the rate; the notes say which. Rotation tags are ignored, as for images.
/// Errors: not_found, corrupt (cannot be opened or holds no frame), and those of calibrations.
[[nodiscard]] Expected<std::unique_ptr<FrameSource>> open_video(const std::string& path,
                                                                const SourceOptions& options);

}  // namespace corvid
