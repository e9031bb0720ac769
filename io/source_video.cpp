#include "io/source_video.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <filesystem>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <string_view>

#include "core/messages.h"
#include "io/ffmpeg_log.h"
#include "io/readers/text.h"
#include "io/source_images.h"
#include "io/time_file.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

using namespace std::string_view_literals;

constexpr int kTimeProbe =
    30;  // frames whose container times are looked at before they are trusted
constexpr double kDefaultRate_hz = 30;

class VideoSource final : public FrameSource {
 public:
  static Expected<std::unique_ptr<FrameSource>> open(const std::string& path,
                                                     const SourceOptions& options);
  [[nodiscard]] const SourceInfo& info() const override { return info_; }
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop) override;
  [[nodiscard]] SourceCounts counts() const override { return counts_; }

 private:
  [[nodiscard]] bool reopen();
  [[nodiscard]] bool probe_times();
  [[nodiscard]] Expected<void> take_time_file();
  [[nodiscard]] Expected<void> take_camera();
  [[nodiscard]] bool grab();
  [[nodiscard]] const TimeLine* line_of_grabbed();
  void report_lines_without_frame(std::size_t end);
  [[nodiscard]] std::int64_t time_of(std::int64_t index, const TimeLine* line);
  [[nodiscard]] bool chosen(std::int64_t index) const {
    return index >= options_.first && (index - options_.first) % options_.step == 0;
  }
  [[nodiscard]] std::int64_t container_time_ns() {
    return static_cast<std::int64_t>(std::llround(video_.get(cv::CAP_PROP_POS_MSEC) * 1e6));
  }
  void skip(std::string message) {
    ++counts_.skipped;
    add_message(counts_.messages, std::move(message));
  }
  void report_missing_end();
  [[nodiscard]] FramePtr make_frame(const cv::Mat& image, std::int64_t time_ns);

  SourceOptions options_;
  SourceInfo info_;
  cv::VideoCapture video_;
  int width_px_ = 0, height_px_ = 0;
  bool container_times_ = false;
  bool ended_ = false;
  std::int64_t promised_ = 0;  ///< frames that the container speaks of; 0: says nothing
  std::int64_t position_ = 0;  ///< frames of the file that were grabbed
  std::int64_t taken_ = 0;     ///< of these, frames that the options let through
  std::optional<std::int64_t> last_time_ns_;
  std::optional<TimeFile> times_;  ///< what lies beside the video
  std::size_t next_line_ = 0;
  std::int64_t file_bytes_ = 0;
  bool grey_ = false;  ///< the decoder gives grey pictures, which OpenCV makes three channels of
  SourceCounts counts_;
};

bool VideoSource::reopen() {
  video_.release();
  if (!video_.open(info_.path, cv::CAP_FFMPEG)) return false;
  video_.set(cv::CAP_PROP_ORIENTATION_AUTO, 0);
  return true;
}

// Whether the first frames' times rise; the file has to be opened again afterwards.
bool VideoSource::probe_times() {
  std::optional<std::int64_t> last;
  int frames = 0;
  for (; frames < kTimeProbe && video_.grab(); ++frames) {
    const std::int64_t time = container_time_ns();
    if (time < 0 || (last && time <= *last)) return false;
    last = time;
  }
  return frames > 0;
}

Expected<void> VideoSource::take_time_file() {
  const fs::path path = time_file_of(info_.path);
  std::error_code ignored;
  if (!fs::is_regular_file(path, ignored)) return {};
  auto file = read_time_file(path);
  if (!file) return tl::unexpected(file.error());
  times_ = std::move(*file);
  file_bytes_ = static_cast<std::int64_t>(fs::file_size(info_.path, ignored));
  for (std::string& message : times_->skipped) skip(std::move(message));
  if (times_->torn) {
    info_.notes.push_back(fmt::format("{}: the last line is cut off and left out", path.string()));
  }
  if (times_->lines.empty()) {
    return fail(
        ErrorCode::corrupt, "the time file lists no frame", path.string(),
        "each line is \"frame,time in ns\"; without the file the container's times are used");
  }
  return {};
}

// Lines from the next one to `end` have no frame.
void VideoSource::report_lines_without_frame(std::size_t end) {
  for (; next_line_ < end; ++next_line_) {
    const std::int64_t frame = times_->lines[next_line_].frame;
    if (!chosen(frame)) continue;
    ++taken_;
    skip(fmt::format("{}: frame {} is in the time file, but not whole in the video", info_.path,
                     frame));
  }
}

// The next frame of the file. OpenCV gives up at one that cannot be decoded, but goes on behind it
// when it is asked again: as often as lines say that there is more.
bool VideoSource::grab() {
  if (video_.grab()) return true;
  for (std::size_t i = times_ ? next_line_ : 0; times_ && i < times_->lines.size(); ++i) {
    if (video_.grab()) return true;
  }
  return false;
}

// The line of the frame that was grabbed last; null, and counted, if it is not known to be whole.
const TimeLine* VideoSource::line_of_grabbed() {
  const std::vector<TimeLine>& lines = times_->lines;
  const double shown_ms = video_.get(cv::CAP_PROP_POS_MSEC);
  // How far the line is after the frame: in the container's time, or in frames.
  const auto after = [&](const TimeLine& line) {
    return line.shown_ms ? *line.shown_ms - shown_ms
                         : static_cast<double>(line.frame - (position_ - 1));
  };
  std::size_t at = next_line_;
  while (at < lines.size() && after(lines[at]) < -0.5) ++at;
  report_lines_without_frame(at);
  if (at == lines.size() || after(lines[at]) > 0.5) {
    skip(fmt::format("{}: a frame at {:.3f} s has no line in the time file", info_.path,
                     shown_ms * 1e-3));
    return nullptr;
  }
  if (lines[at].bytes && *lines[at].bytes > file_bytes_) {  // the decoder gave a part of it
    report_lines_without_frame(at + 1);
    return nullptr;
  }
  ++next_line_;
  return &lines[at];
}

std::int64_t VideoSource::time_of(std::int64_t index, const TimeLine* line) {
  if (options_.rate_hz) return std::llround(static_cast<double>(index) * 1e9 / *options_.rate_hz);
  if (line != nullptr) return line->time_ns;
  const std::int64_t time = container_time_ns();
  // The last frames of a stream with B-frames come out of the decoder without a time (0).
  if (time == 0 && last_time_ns_ && info_.rate_hz > 0)
    return *last_time_ns_ + std::llround(1e9 / info_.rate_hz);
  return time;
}

Expected<void> VideoSource::take_camera() {
  std::string path = options_.calibration_path;
  for (const char* ending : {".yaml", ".yml", ".xml", ".txt"}) {
    const fs::path beside = fs::path(info_.path).replace_extension(ending);
    std::error_code ignored;
    if (path.empty() && fs::is_regular_file(beside, ignored)) path = beside.string();
  }
  return take_calibration(path, width_px_, height_px_, info_);
}

Expected<std::unique_ptr<FrameSource>> VideoSource::open(const std::string& path,
                                                         const SourceOptions& options) {
  auto source = std::make_unique<VideoSource>();
  VideoSource& s = *source;
  s.options_ = options;
  s.info_.kind = "video file";
  s.info_.path = path;
  if (!s.reopen()) {
    return fail(ErrorCode::corrupt, "the video cannot be opened", path,
                "it may be cut off or of a format that FFmpeg does not know");
  }
  cv::Mat first;
  if (!s.video_.read(first) || first.empty()) {
    return fail(ErrorCode::corrupt, "the video holds no frame that can be decoded", path);
  }
  s.width_px_ = first.cols;
  s.height_px_ = first.rows;
  s.info_.colour = options.colour && first.channels() == 3;
  // V4L2's name of FFmpeg's gray.
  s.grey_ = s.video_.get(cv::CAP_PROP_CODEC_PIXEL_FORMAT) ==
            static_cast<double>(cv::VideoWriter::fourcc('Y', '8', '0', '0'));
  s.info_.colour = s.info_.colour && !s.grey_;
  double rate = s.video_.get(cv::CAP_PROP_FPS);
  if (!(rate >= 1e-3 && rate <= 1e6)) {
    rate = kDefaultRate_hz;
    s.info_.notes.push_back(fmt::format("the video names no frame rate: {} Hz is assumed", rate));
  }
  if (auto ok = s.take_time_file(); !ok) return tl::unexpected(ok.error());
  const double count = s.video_.get(cv::CAP_PROP_FRAME_COUNT);
  if (s.times_ || (count >= 1 && count < 1e9)) {
    std::int64_t all = 0;
    if (s.times_) {
      for (const TimeLine& line : s.times_->lines) all += s.chosen(line.frame) ? 1 : 0;
    } else {
      s.promised_ = static_cast<std::int64_t>(count);
      const std::int64_t after = std::max<std::int64_t>(0, s.promised_ - options.first);
      all = (after + options.step - 1) / options.step;
    }
    s.info_.frames = static_cast<std::size_t>(
        options.count < 0 ? all : std::min<std::int64_t>(all, options.count));
  }
  const double turn = s.video_.get(cv::CAP_PROP_ORIENTATION_META);
  if (std::isfinite(turn) && turn != 0) {
    s.info_.notes.push_back(fmt::format(
        "the video asks players to turn it by {} degrees: it is used as it is stored", turn));
  }
  if (!s.reopen()) return fail(ErrorCode::io, "the video cannot be opened again", path);
  if (!options.rate_hz && s.times_) {
    s.info_.notes.push_back(fmt::format("times from {}", time_file_of(path).string()));
  } else {
    s.container_times_ = !options.rate_hz && s.probe_times();
    if (!s.container_times_) s.options_.rate_hz = options.rate_hz.value_or(rate);
  }
  if (!options.rate_hz && !s.times_) {
    s.info_.notes.push_back(
        s.container_times_
            ? "times are the container's"
            : fmt::format("the container's times do not rise: frames are taken at {:.6g} Hz",
                          rate));
  }
  s.info_.rate_hz = s.options_.rate_hz.value_or(rate) / options.step;
  if (auto ok = s.take_camera(); !ok) return tl::unexpected(ok.error());
  if (!s.reopen()) return fail(ErrorCode::io, "the video cannot be opened again", path);
  return source;
}

FramePtr VideoSource::make_frame(const cv::Mat& image, std::int64_t time_ns) {
  auto frame = std::make_shared<Frame>();
  frame->id = FrameId(static_cast<std::uint32_t>(taken_ - 1));
  frame->time_ns = time_ns;
  frame->camera = info_.camera;
  frame->name = fmt::format("{:06d}", position_ - 1);
  frame->grey = GreyImage(image.cols, image.rows);
  cv::Mat grey(image.rows, image.cols, CV_8UC1, frame->grey.data());
  if (image.channels() == 1) {
    image.copyTo(grey);
    return frame;
  }
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);  // three equal channels: exactly their value
  if (info_.colour) {
    frame->colour = ColourImage(image.cols, image.rows);
    cv::Mat rgb(image.rows, image.cols, CV_8UC3, frame->colour.data());
    cv::cvtColor(image, rgb, cv::COLOR_BGR2RGB);
  }
  return frame;
}

// Containers estimate their length, so a frame or two mean nothing.
void VideoSource::report_missing_end() {
  const bool to_the_end = options_.count < 0 || taken_ < options_.count;
  if (to_the_end && position_ + 2 < promised_) {
    // Only frames that the options would have let through are missed.
    const auto let_through = [&](std::int64_t frames) {
      const std::int64_t after = std::max<std::int64_t>(0, frames - options_.first);
      return (after + options_.step - 1) / options_.step;
    };
    std::int64_t missing = let_through(promised_) - let_through(position_);
    if (options_.count >= 0) missing = std::min<std::int64_t>(missing, options_.count - taken_);
    if (missing <= 0) return;
    counts_.skipped += static_cast<std::uint64_t>(missing);
    add_message(counts_.messages, fmt::format("{}: the video ends after {} of {} frames",
                                              info_.path, position_, promised_));
  }
}

Expected<FramePtr> VideoSource::next(const std::stop_token& stop) {
  cv::Mat image;
  try {
    while (!ended_ && !stop.stop_requested()) {
      if ((options_.count >= 0 && taken_ >= options_.count) || !grab()) {
        ended_ = true;
        if (options_.count < 0 || taken_ < options_.count) {
          if (times_) {
            report_lines_without_frame(times_->lines.size());
          } else {
            report_missing_end();
          }
        }
        break;
      }
      std::int64_t index = position_++;
      const TimeLine* line = nullptr;
      if (times_) {
        line = line_of_grabbed();
        if (line == nullptr) continue;
        index = line->frame;
      }
      if (!chosen(index)) continue;
      ++taken_;
      const std::int64_t time = time_of(index, line);
      if (last_time_ns_ && time <= *last_time_ns_) {
        skip(fmt::format("{}: frame {}: its time {} ns does not follow {} ns", info_.path, index,
                         time, *last_time_ns_));
        continue;
      }
      if (!video_.retrieve(image) || image.empty() || image.depth() != CV_8U) {
        skip(fmt::format("{}: frame {} cannot be decoded", info_.path, index));
        continue;
      }
      if (image.cols != width_px_ || image.rows != height_px_) {
        skip(fmt::format("{}: frame {} has {} x {} pixels but the first has {} x {}", info_.path,
                         index, image.cols, image.rows, width_px_, height_px_));
        continue;
      }
      last_time_ns_ = time;
      ++counts_.delivered;
      return make_frame(image, time);
    }
  } catch (const cv::Exception& e) {
    return fail(ErrorCode::io, fmt::format("the decoder gave up: {}", e.err), info_.path);
  }
  if (counts_.delivered == 0 && !stop.stop_requested()) {
    return fail(ErrorCode::corrupt,
                fmt::format("none of the video's {} frames could be used{}{}", position_,
                            counts_.messages.empty() ? "" : "; the first: ",
                            counts_.messages.empty() ? "" : counts_.messages.front()),
                info_.path);
  }
  return nullptr;
}

}  // namespace

bool is_video_name(const std::string& name) {
  static constexpr std::array kEndings = {
      ".mp4"sv, ".mov"sv, ".avi"sv, ".mkv"sv, ".webm"sv, ".m4v"sv,  ".mpg"sv, ".ts"sv,   ".mpeg"sv,
      ".mts"sv, ".wmv"sv, ".3gp"sv, ".ogv"sv, ".h264"sv, ".hevc"sv, ".flv"sv, ".m2ts"sv, ".y4m"sv};
  const std::string lower = lower_case(name);
  return std::any_of(kEndings.begin(), kEndings.end(),
                     [&](std::string_view ending) { return lower.ends_with(ending); });
}

Expected<std::unique_ptr<FrameSource>> open_video(const std::string& path,
                                                  const SourceOptions& options) {
  catch_ffmpeg_log();
  try {
    return VideoSource::open(path, options);
  } catch (const cv::Exception& e) {
    return fail(ErrorCode::corrupt, fmt::format("the video cannot be opened: {}", e.err), path);
  }
}

}  // namespace corvid
