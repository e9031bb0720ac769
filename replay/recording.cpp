#include "replay/recording.h"

#include <string>
#include <utility>

#include "io/source_video.h"
#include "io/video_recording.h"
#include "replay/recorder.h"

namespace corvid {

Expected<std::unique_ptr<RecordingWriter>> open_recording(const std::filesystem::path& path,
                                                          std::optional<RecordingFormat> format,
                                                          const SourceInfo& info) {
  const bool video_name = is_video_name(path.string());
  if (!format && video_name)
    format = path.extension() == ".avi" ? RecordingFormat::mjpeg : RecordingFormat::ffv1;
  if (format && *format != RecordingFormat::asl) {
    return create_video_recording(
        path, *format == RecordingFormat::ffv1 ? VideoCodec::ffv1 : VideoCodec::mjpeg, info);
  }
  if (video_name) {
    return fail(ErrorCode::invalid_argument, "a folder cannot have a video's name", path.string(),
                "name a folder, or choose another format");
  }
  auto recorder = Recorder::open(path, info);
  if (!recorder) return tl::unexpected(recorder.error());
  return std::make_unique<Recorder>(std::move(*recorder));
}

}  // namespace corvid
