#pragma once

#include <filesystem>
#include <memory>

#include "corvid/error.h"
#include "corvid/ports.h"
#include "io/recording_writer.h"

namespace corvid {

enum class VideoCodec {
  ffv1,  ///< without loss, every frame on its own, with checksums
  mjpeg  ///< JPEG of quality 92
};

/// Records into a video (.mkv or .avi, by the name), with the time file and, unless the source's
/// intrinsics are a guess, the calibration (.yaml) beside it. Grey frames are grey there, colour
/// ones have their colour.
///
/// Killed at any moment, every frame that has a line in the time file is there: each is handed to
/// the system before its line is. The container's own index is written by finish(); readers do
/// without. Errors: invalid_argument (another ending, a recording or another camera's calibration
/// lies there already, a size that the codec cannot take), io.
[[nodiscard]] Expected<std::unique_ptr<RecordingWriter>> create_video_recording(
    const std::filesystem::path& path, VideoCodec codec, const SourceInfo& info);

}  // namespace corvid
