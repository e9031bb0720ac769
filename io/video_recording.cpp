#include "io/video_recording.h"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <utility>

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
}

#include "core/check.h"
#include "io/calibration.h"
#include "io/ffmpeg_log.h"
#include "io/ffv1_encoder.h"
#include "io/image_encode.h"
#include "io/io_fault.h"
#include "io/readers/text.h"
#include "io/time_file.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

constexpr int kJpegQuality = 92;
constexpr double kDefaultRate_hz = 30;

class VideoRecording final : public RecordingWriter {
 public:
  VideoRecording(fs::path path, const SourceInfo& info) : path_(std::move(path)) {
    width_px_ = info.camera->width_px;
    height_px_ = info.camera->height_px;
    colour_ = info.colour;
    const bool known = info.rate_hz >= 1e-3 && info.rate_hz <= 1e6;
    rate_hz_ = known ? info.rate_hz : kDefaultRate_hz;
  }
  ~VideoRecording() override {
    if (container_ == nullptr) return;
    if (container_->pb != nullptr) avio_closep(&container_->pb);
    avformat_free_context(container_);
    av_packet_free(&packet_);
  }
  VideoRecording(const VideoRecording&) = delete;
  VideoRecording& operator=(const VideoRecording&) = delete;

  [[nodiscard]] Expected<void> open(VideoCodec codec, bool matroska);
  [[nodiscard]] Expected<std::vector<std::uint8_t>> encode(const Frame& frame) override;
  [[nodiscard]] Expected<void> append(const Frame& frame,
                                      std::span<const std::uint8_t> picture) override;
  [[nodiscard]] Expected<bool> write_truth(const Trajectory&) override { return false; }
  [[nodiscard]] Expected<void> finish() override;

 private:
  [[nodiscard]] Expected<void> describe(VideoCodec codec, AVStream& stream);
  [[nodiscard]] Expected<void> flush();

  const fs::path path_;
  int width_px_, height_px_;
  bool colour_, matroska_ = true;
  double rate_hz_;
  std::unique_ptr<Ffv1Encoder> ffv1_;  ///< null: JPEG
  AVFormatContext* container_ = nullptr;
  AVPacket* packet_ = nullptr;
  std::optional<TimeFileWriter> times_;
  std::int64_t frames_ = 0, first_ns_ = 0, last_ns_ = -1, last_stamp_ = -1;
};

Expected<void> VideoRecording::describe(VideoCodec codec, AVStream& stream) {
  AVCodecParameters& p = *stream.codecpar;
  if (codec == VideoCodec::ffv1) {
    auto encoder = Ffv1Encoder::create(width_px_, height_px_, colour_);
    if (!encoder) return tl::unexpected(encoder.error());
    ffv1_ = std::move(*encoder);
    return ffv1_->describe(p);
  }
  p.codec_type = AVMEDIA_TYPE_VIDEO;
  p.codec_id = AV_CODEC_ID_MJPEG;
  p.width = width_px_;
  p.height = height_px_;
  p.format = colour_ ? AV_PIX_FMT_YUVJ420P : AV_PIX_FMT_GRAY8;
  p.color_range = AVCOL_RANGE_JPEG;
  return {};
}

Expected<void> VideoRecording::open(VideoCodec codec, bool matroska) {
  catch_ffmpeg_log();
  matroska_ = matroska;
  packet_ = av_packet_alloc();
  const std::string name = path_.string();
  avformat_alloc_output_context2(&container_, nullptr, matroska ? "matroska" : "avi", name.c_str());
  CORVID_CHECK(container_ != nullptr && packet_ != nullptr, "FFmpeg without memory or containers");
  AVStream* stream = avformat_new_stream(container_, nullptr);
  CORVID_CHECK(stream != nullptr, "FFmpeg without memory");
  if (auto ok = describe(codec, *stream); !ok) return ok;
  const AVRational rate = av_d2q(rate_hz_, 1'000'000);
  stream->avg_frame_rate = stream->r_frame_rate = rate;
  // Matroska shows the frames at their capture times, in milliseconds; AVI counts.
  stream->time_base = matroska ? AVRational{1, 1000} : av_inv_q(rate);
  int code = avio_open(&container_->pb, name.c_str(), AVIO_FLAG_WRITE);
  if (code < 0) return io_fault("cannot be written", path_, AVUNERROR(code));
  code = avformat_write_header(container_, nullptr);
  if (code < 0 && container_->pb->error == 0) {
    return fail(
        ErrorCode::unsupported,
        fmt::format("the container does not take pictures of {} x {} px", width_px_, height_px_),
        name, "record as a folder");
  }
  if (auto ok = flush(); !ok) return ok;
  auto times = TimeFileWriter::create(time_file_of(path_));
  if (!times) return tl::unexpected(times.error());
  times_ = std::move(*times);
  return {};
}

Expected<std::vector<std::uint8_t>> VideoRecording::encode(const Frame& frame) {
  const bool fits =
      frame.grey.width() == width_px_ && frame.grey.height() == height_px_ &&
      (!colour_ || (frame.colour.width() == width_px_ && frame.colour.height() == height_px_));
  if (!fits) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("frame {} has {} x {} px, the video {} x {}{}", frame.id.value,
                            frame.grey.width(), frame.grey.height(), width_px_, height_px_,
                            colour_ && frame.colour.empty() ? " in colour" : ""),
                path_.string());
  }
  if (ffv1_) return ffv1_->encode(frame);
  const std::string jpeg =
      colour_ ? encode_jpeg(frame.colour, kJpegQuality) : encode_jpeg(frame.grey, kJpegQuality);
  return std::vector<std::uint8_t>(jpeg.begin(), jpeg.end());
}

// Everything that the muxer holds back goes to the system.
Expected<void> VideoRecording::flush() {
  av_write_frame(container_, nullptr);
  avio_flush(container_->pb);
  if (const int code = container_->pb->error; code < 0)
    return io_fault("cannot be written", path_, AVUNERROR(code));
  return {};
}

Expected<void> VideoRecording::append(const Frame& frame, std::span<const std::uint8_t> picture) {
  if (frame.time_ns <= last_ns_) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("capture time {} ns does not follow {} ns", frame.time_ns, last_ns_),
                fmt::format("frame {}", frame.id.value));
  }
  if (frames_ == 0) first_ns_ = frame.time_ns;
  const std::int64_t stamp =
      matroska_ ? std::max((frame.time_ns - first_ns_ + 500'000) / 1'000'000, last_stamp_ + 1)
                : frames_;
  const AVStream& stream = *container_->streams[0];
  if (av_new_packet(packet_, static_cast<int>(picture.size())) < 0)
    return fail(ErrorCode::io, "out of memory", path_.string());
  std::copy(picture.begin(), picture.end(), packet_->data);
  packet_->flags |= AV_PKT_FLAG_KEY;
  packet_->pts = packet_->dts = stamp;
  packet_->duration = matroska_ ? std::max<std::int64_t>(1, std::llround(1000 / rate_hz_)) : 1;
  const int code = av_write_frame(container_, packet_);
  av_packet_unref(packet_);
  if (auto ok = flush(); !ok) return ok;
  if (code < 0) {
    return fail(ErrorCode::io, fmt::format("the container refuses frame {}", frame.id.value),
                path_.string());
  }
  const double shown_ms = static_cast<double>(stamp) * av_q2d(stream.time_base) * 1e3;
  if (auto ok = times_->append(
          {frames_, frame.time_ns, frame.id.value, shown_ms, avio_tell(container_->pb)});
      !ok)
    return ok;
  ++frames_;
  last_ns_ = frame.time_ns;
  last_stamp_ = stamp;
  return {};
}

Expected<void> VideoRecording::finish() {
  const int code = av_write_trailer(container_);
  const int written = avio_closep(&container_->pb);
  if (code < 0 || written < 0)
    return io_fault("its index cannot be written", path_, AVUNERROR(std::min(code, written)));
  return {};
}

tl::unexpected<Error> in_the_way(const fs::path& path, const char* what) {
  return fail(ErrorCode::invalid_argument, what, path.string(), "record under a new name");
}

/// Writes the calibration, unless it is a guess, or lies there already.
Expected<void> write_camera(const fs::path& path, const SourceInfo& info) {
  std::error_code ignored;
  if (fs::exists(path, ignored)) {
    const auto there = read_calibration(path.string());
    if (there && there->camera == *info.camera && info.intrinsics != IntrinsicsOrigin::guess)
      return {};
    return in_the_way(path, "there is another camera's calibration");
  }
  // A guess in a file would be taken for a calibration, and not be refined.
  if (info.intrinsics == IntrinsicsOrigin::guess) return {};
  return write_calibration(path.string(), *info.camera,
                           info.camera->model == CameraModel::fov ? CalibrationFormat::kalibr
                                                                  : CalibrationFormat::opencv);
}

/// Removes a file that this process made; what a link leads to is somebody else's.
void remove_made(const fs::path& file) {
  std::error_code ignored;
  if (fs::is_regular_file(fs::symlink_status(file, ignored))) fs::remove(file, ignored);
}

}  // namespace

Expected<std::unique_ptr<RecordingWriter>> create_video_recording(const fs::path& path,
                                                                  VideoCodec codec,
                                                                  const SourceInfo& info) {
  CORVID_CHECK(info.camera != nullptr, "a source without a camera cannot be recorded");
  const std::string ending = lower_case(path.extension().string());
  if (ending != ".mkv" && ending != ".avi") {
    return fail(ErrorCode::invalid_argument, "videos are written as .mkv or .avi", path.string(),
                "choose one of these endings, or a folder");
  }
  std::error_code trouble;
  for (const fs::path& file : {path, time_file_of(path)}) {
    if (fs::exists(file, trouble)) return in_the_way(file, "there is a recording already");
  }
  if (path.has_parent_path()) fs::create_directories(path.parent_path(), trouble);
  if (trouble == std::errc::not_a_directory || trouble == std::errc::file_exists) {
    return fail(ErrorCode::invalid_argument, "lies below a file, where a folder must be",
                path.string(), "record into another folder");
  }
  if (trouble) return io_fault("folder cannot be made", path.parent_path(), trouble.value());
  const fs::path camera = fs::path(path).replace_extension(".yaml");
  const bool had_camera = fs::exists(camera, trouble);
  if (auto ok = write_camera(camera, info); !ok) return tl::unexpected(ok.error());
  auto recording = std::make_unique<VideoRecording>(path, info);
  if (auto ok = recording->open(codec, ending == ".mkv"); !ok) {
    recording.reset();
    // What is left would be taken for a recording when it is tried again.
    for (const fs::path& file : {path, time_file_of(path)}) remove_made(file);
    if (!had_camera) remove_made(camera);
    return tl::unexpected(ok.error());
  }
  return recording;
}

}  // namespace corvid
