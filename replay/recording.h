#pragma once

#include <filesystem>
#include <memory>
#include <optional>

#include "corvid/error.h"
#include "corvid/ports.h"
#include "io/recording_writer.h"

namespace corvid {

enum class RecordingFormat {
  asl,   ///< a folder, PNG: without loss (replay/recorder.h)
  ffv1,  ///< a video without loss (io/video_recording.h)
  mjpeg  ///< a video of JPEGs
};

/// Begins a recording. Without a format the name decides: .mkv is ffv1, .avi is mjpeg, all else a
/// folder. Errors: those of Recorder::open and create_video_recording.
[[nodiscard]] Expected<std::unique_ptr<RecordingWriter>> open_recording(
    const std::filesystem::path& path, std::optional<RecordingFormat> format,
    const SourceInfo& info);

}  // namespace corvid
