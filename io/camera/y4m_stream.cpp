#include "io/camera/y4m_stream.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <opencv2/imgproc.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/log.h"
#include "core/messages.h"
#include "io/camera/upper_bits.h"
#include "io/camera/y4m_header.h"
#include "io/io_fault.h"

namespace corvid {
namespace {

using std::chrono::milliseconds;
using SteadyTime = std::chrono::steady_clock::time_point;

constexpr milliseconds kHeaderWait{10'000};
constexpr milliseconds kPoll{50};  // after which a wish to stop is looked at
constexpr std::size_t kReadAhead = 1 << 16;
constexpr std::int64_t kSecond_ns = 1'000'000'000, kMostDelay_ns = kSecond_ns / 2;
// A rate that is wrong makes the count begin anew again and again, after fewer frames than this.
constexpr std::int64_t kSoon = 100;
constexpr int kMostSoon = 3;
constexpr std::string_view kFrameMark = "FRAME";

enum class Got { enough, not_yet, end };

/// Bytes from a descriptor, which no wait for them blocks.
class PipeReader {
 public:
  PipeReader(int fd, bool owned, std::string where)
      : fd_(fd), owned_(owned), where_(std::move(where)) {}
  ~PipeReader() {
    if (owned_) ::close(fd_);
  }
  PipeReader(const PipeReader&) = delete;
  PipeReader& operator=(const PipeReader&) = delete;

  [[nodiscard]] std::string_view bytes() const { return {buffer_.data() + begin_, end_ - begin_}; }
  void take(std::size_t count) {
    begin_ += count;
    taken_ += count;
  }
  [[nodiscard]] std::uint64_t taken() const { return taken_; }
  [[nodiscard]] const std::string& where() const { return where_; }

  /// Waits until `count` bytes are there, the time is over, or somebody wants to stop.
  [[nodiscard]] Expected<Got> need(std::size_t count, SteadyTime until,
                                   const std::stop_token& stop);
  /// The same for a whole line, whose length without the line feed goes to `length`.
  [[nodiscard]] Expected<Got> need_line(std::size_t& length, SteadyTime until,
                                        const std::stop_token& stop);

 private:
  void make_room();

  int fd_;
  bool owned_;
  std::string where_;
  std::vector<char> buffer_;         ///< never shrinks
  std::size_t begin_ = 0, end_ = 0;  ///< of the bytes in it
  std::uint64_t taken_ = 0;
};

// For kReadAhead bytes behind those that are there.
void PipeReader::make_room() {
  if (buffer_.size() - end_ >= kReadAhead) return;
  std::copy(buffer_.begin() + static_cast<std::ptrdiff_t>(begin_),
            buffer_.begin() + static_cast<std::ptrdiff_t>(end_), buffer_.begin());
  end_ -= std::exchange(begin_, 0);
  if (buffer_.size() - end_ < kReadAhead) buffer_.resize(end_ + kReadAhead);
}

Expected<Got> PipeReader::need(std::size_t count, SteadyTime until, const std::stop_token& stop) {
  while (bytes().size() < count) {
    if (stop.stop_requested()) return Got::not_yet;
    const auto left = std::chrono::ceil<milliseconds>(until - std::chrono::steady_clock::now());
    pollfd poll{fd_, POLLIN, 0};
    const int wait_ms = static_cast<int>(std::clamp(left, milliseconds(0), kPoll).count());
    const int ready = ::poll(&poll, 1, wait_ms);
    if (ready < 0 && errno != EINTR) return io_fault("cannot be waited for", where_, errno);
    if (ready <= 0) {
      if (left.count() <= 0) return Got::not_yet;
      continue;
    }
    // A fifo that no writer has opened yet is quiet here: only a hang-up without bytes is the end.
    if ((poll.revents & POLLIN) == 0) {
      if ((poll.revents & POLLHUP) != 0) return Got::end;
      return io_fault("cannot be read", where_, EIO);
    }
    make_room();
    const ssize_t got = ::read(fd_, buffer_.data() + end_, kReadAhead);
    if (got == 0) return Got::end;
    if (got > 0) {
      end_ += static_cast<std::size_t>(got);
    } else if (errno != EINTR && errno != EAGAIN) {
      return io_fault("cannot be read", where_, errno);
    }
  }
  return Got::enough;
}

Expected<Got> PipeReader::need_line(std::size_t& length, SteadyTime until,
                                    const std::stop_token& stop) {
  while (true) {
    length = bytes().find('\n');
    if (length != std::string_view::npos && length <= kMaxY4mLine) return Got::enough;
    if (bytes().size() > kMaxY4mLine) {
      length = kMaxY4mLine;
      return Got::enough;
    }
    auto got = need(bytes().size() + 1, until, stop);
    if (!got || *got != Got::enough) return got;
  }
}

class Y4mStream final : public CameraStream {
 public:
  Y4mStream(std::unique_ptr<PipeReader> pipe, Y4mHeader header, const CameraRequest& request,
            Clock& clock);
  [[nodiscard]] const StreamSettings& settings() const override { return settings_; }
  [[nodiscard]] Expected<std::optional<Capture>> next(milliseconds timeout,
                                                      const std::stop_token& stop) override;
  [[nodiscard]] StreamCounts counts() const override { return counts_; }
  [[nodiscard]] bool reopens() const override { return false; }
  [[nodiscard]] bool ended() const override { return ended_; }

 private:
  void end();
  [[nodiscard]] tl::unexpected<Error> broken(std::string what);
  [[nodiscard]] std::int64_t capture_time_ns();
  [[nodiscard]] Capture make_capture();

  std::unique_ptr<PipeReader> pipe_;
  const Y4mHeader header_;
  const bool colour_;
  Clock& clock_;
  StreamSettings settings_;
  StreamCounts counts_;
  bool ended_ = false;
  bool in_frame_ = false;  ///< the mark was read, its picture was not
  std::uint64_t sequence_ = 0;
  std::int64_t anchor_ns_ = 0, last_ns_ = -1;
  std::int64_t since_anchor_ = 0;  ///< frames
  int soon_ = 0;                   ///< times in a row that the count began anew soon after it had
};

Y4mStream::Y4mStream(std::unique_ptr<PipeReader> pipe, Y4mHeader header,
                     const CameraRequest& request, Clock& clock)
    : pipe_(std::move(pipe)), header_(std::move(header)), colour_(request.colour), clock_(clock) {
  settings_.format = "y4m " + header_.colour;
  settings_.colour = colour_ && !header_.colour.starts_with("mono");
  settings_.width_px = header_.width_px;
  settings_.height_px = header_.height_px;
  auto& notes = settings_.notes;
  if (header_.rate_num > 0) {
    settings_.rate_hz =
        static_cast<double>(header_.rate_num) / static_cast<double>(header_.rate_den);
    notes.push_back(fmt::format(
        "times are counted: the arrival of the first frame, then {:.6g} frames per second",
        settings_.rate_hz));
  } else {
    notes.emplace_back("the stream names no rate: times are those of arrival");
  }
  if (header_.unknown_order)
    notes.emplace_back("the stream does not say whether it is interlaced: it is taken as it is");
  if (header_.limited && header_.chroma_width_px > 0)
    notes.emplace_back("the luma's range is taken as it is (16 to 235)");
  if (header_.bits > 8)
    notes.push_back(fmt::format("of {} bits the upper 8 are taken", header_.bits));
  const bool differs = (request.width_px > 0 && request.width_px != header_.width_px) ||
                       (request.height_px > 0 && request.height_px != header_.height_px) ||
                       (request.rate_hz > 0 && request.rate_hz != settings_.rate_hz) ||
                       !request.format.empty() || request.exposure_s || request.gain;
  if (differs)
    notes.emplace_back(
        "format, size, rate, exposure and gain cannot be asked of a pipe: it is taken as it comes");
}

// The end of the bytes: what is left of a frame is not a frame.
void Y4mStream::end() {
  ended_ = true;
  if (!in_frame_ && pipe_->bytes().empty()) return;
  ++counts_.damaged;
  add_message(counts_.messages,
              fmt::format("{}: frame {} is cut off: {} of {} bytes", pipe_->where(), sequence_,
                          in_frame_ ? pipe_->bytes().size() : 0, header_.frame_bytes()));
}

tl::unexpected<Error> Y4mStream::broken(std::string what) {
  ended_ = true;
  return fail(ErrorCode::io, std::move(what),
              fmt::format("{}, byte {}", pipe_->where(), pipe_->taken()),
              "the producer wrote something else in between, or bytes were lost");
}

std::int64_t Y4mStream::capture_time_ns() {
  const std::int64_t now_ns = clock_.now_ns();
  if (header_.rate_num == 0 || soon_ >= kMostSoon) return last_ns_ = std::max(now_ns, last_ns_ + 1);
  if (sequence_ == 0) anchor_ns_ = now_ns;
  // frames * den / num in whole seconds and the rest, so that nothing overflows.
  const std::int64_t units = since_anchor_ * header_.rate_den;
  std::int64_t time_ns = anchor_ns_ + units / header_.rate_num * kSecond_ns +
                         units % header_.rate_num * kSecond_ns / header_.rate_num;
  ++since_anchor_;
  if (time_ns > now_ns) {  // no picture comes before it was taken: those before were late
    anchor_ns_ -= time_ns - now_ns;
    time_ns = now_ns;
  } else if (now_ns - time_ns > kMostDelay_ns) {
    soon_ = since_anchor_ <= kSoon ? soon_ + 1 : 1;
    log().warn("{}: frame {} came {:.1f} s after its counted time: {}", pipe_->where(), sequence_,
               static_cast<double>(now_ns - time_ns) * 1e-9,
               soon_ < kMostSoon ? "the count begins anew"
                                 : "the rate is not what the stream says, times are those of "
                                   "arrival from now on");
    anchor_ns_ = time_ns = now_ns;
    since_anchor_ = 1;
  }
  return last_ns_ = std::max(time_ns, last_ns_ + 1);
}

/// A plane of 8 bits, whatever the samples are.
cv::Mat plane8(const char* bytes, int width_px, int height_px, int bits) {
  auto* data = const_cast<char*>(bytes);  // only read
  if (bits == 8) return cv::Mat(height_px, width_px, CV_8UC1, data);
  cv::Mat result(height_px, width_px, CV_8UC1);
  take_upper_bits(reinterpret_cast<const std::uint8_t*>(bytes), result.total(), bits, result.data);
  return result;
}

/// BT.601.
ColourImage to_rgb(const Y4mHeader& header, const char* bytes) {
  const cv::Size size(header.width_px, header.height_px);
  const std::size_t luma = header.luma_bytes();
  const std::size_t chroma = static_cast<std::size_t>(header.chroma_width_px) *
                             static_cast<std::size_t>(header.chroma_height_px) *
                             header.sample_bytes();
  std::array<cv::Mat, 3> planes;  // Y, Cr, Cb
  planes[0] = plane8(bytes, size.width, size.height, header.bits);
  for (const std::size_t i : {0u, 1u}) {
    const cv::Mat small = plane8(bytes + luma + i * chroma, header.chroma_width_px,
                                 header.chroma_height_px, header.bits);
    cv::resize(small, planes[2 - i], size, 0, 0, cv::INTER_LINEAR);
  }
  if (header.limited) {
    cv::Mat full;
    planes[0].convertTo(full, CV_8U, 255.0 / 219, -16 * 255.0 / 219);
    planes[0] = full;
    for (const std::size_t i : {1u, 2u})
      planes[i].convertTo(planes[i], CV_8U, 255.0 / 224, 128 - 128 * 255.0 / 224);
  }
  cv::Mat merged;
  cv::merge(planes.data(), planes.size(), merged);
  ColourImage image(size.width, size.height);
  cv::Mat rgb(size, CV_8UC3, image.data());
  cv::cvtColor(merged, rgb, cv::COLOR_YCrCb2RGB);
  return image;
}

Capture Y4mStream::make_capture() {
  Capture capture;
  const char* bytes = pipe_->bytes().data();
  capture.grey = GreyImage(header_.width_px, header_.height_px);
  cv::Mat grey(header_.height_px, header_.width_px, CV_8UC1, capture.grey.data());
  plane8(bytes, header_.width_px, header_.height_px, header_.bits).copyTo(grey);
  if (colour_ && header_.chroma_width_px > 0) capture.colour = to_rgb(header_, bytes);
  capture.time_ns = capture_time_ns();
  capture.sequence = sequence_++;
  return capture;
}

/// Whether the bytes can be the start of "FRAME\n" or "FRAME parameters\n".
bool may_be_mark(std::string_view bytes) {
  const std::size_t known = std::min(bytes.size(), kFrameMark.size());
  if (bytes.substr(0, known) != kFrameMark.substr(0, known)) return false;
  if (bytes.size() > known && bytes[known] != ' ' && bytes[known] != '\n') return false;
  return bytes.size() <= kMaxY4mLine || bytes.find('\n') <= kMaxY4mLine;
}

Expected<std::optional<Capture>> Y4mStream::next(milliseconds timeout,
                                                 const std::stop_token& stop) {
  if (ended_) return std::nullopt;
  const SteadyTime until = std::chrono::steady_clock::now() + timeout;
  if (!in_frame_) {
    // What is wrong from its start need not be waited for until a line feed comes.
    std::size_t length = 0;
    auto got = pipe_->need(kFrameMark.size() + 1, until, stop);
    if (got && *got == Got::enough && pipe_->bytes().starts_with(kFrameMark))
      got = pipe_->need_line(length, until, stop);
    if (!got) {
      ended_ = true;
      return tl::unexpected(got.error());
    }
    if (!may_be_mark(pipe_->bytes())) {
      return broken(fmt::format("frame {} does not begin with FRAME but looks like {}", sequence_,
                                looks_like(pipe_->bytes())));
    }
    if (*got == Got::end) end();
    if (*got != Got::enough) return std::nullopt;
    pipe_->take(length + 1);
    in_frame_ = true;
  }
  const auto got = pipe_->need(header_.frame_bytes(), until, stop);
  if (!got) {
    ended_ = true;
    return tl::unexpected(got.error());
  }
  if (*got == Got::end) end();
  if (*got != Got::enough) return std::nullopt;
  Capture capture = make_capture();
  pipe_->take(header_.frame_bytes());
  in_frame_ = false;
  return capture;
}

tl::unexpected<Error> no_stream(const std::string& where) {
  return fail(ErrorCode::invalid_argument, "is a file, which does not come at a camera's pace",
              where, "`corvid replay FILE.y4m --rate 1.0` flies it at its own");
}

Expected<std::unique_ptr<PipeReader>> open_pipe(const std::string& device) {
  if (device == "-") {
    if (::isatty(STDIN_FILENO) != 0) {
      return fail(ErrorCode::invalid_argument, "the standard input is a terminal", "y4m:-",
                  "let a program write to it: ffmpeg ... -f yuv4mpegpipe - | corvid ...");
    }
    struct stat status {};
    if (::fstat(STDIN_FILENO, &status) == 0 && S_ISREG(status.st_mode))
      return no_stream("the standard input");
    return std::make_unique<PipeReader>(STDIN_FILENO, false, "the standard input");
  }
  const int fd = ::open(device.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) return io_fault("cannot be opened", device, errno);
  auto pipe = std::make_unique<PipeReader>(fd, true, device);
  struct stat status {};
  if (::fstat(fd, &status) != 0) return io_fault("cannot be examined", device, errno);
  if (S_ISDIR(status.st_mode)) {
    return fail(ErrorCode::invalid_argument, "is a folder", device, "name a fifo");
  }
  if (S_ISREG(status.st_mode)) return no_stream(device);
  return pipe;
}

}  // namespace

Expected<std::unique_ptr<CameraStream>> open_y4m(const CameraRequest& request, Clock& clock,
                                                 const std::stop_token& stop) {
  auto pipe = open_pipe(request.device);
  if (!pipe) return tl::unexpected(pipe.error());
  const std::string where = (*pipe)->where();
  std::size_t length = 0;
  const auto got = (*pipe)->need_line(length, std::chrono::steady_clock::now() + kHeaderWait, stop);
  if (!got) return tl::unexpected(got.error());
  const std::string_view bytes = (*pipe)->bytes();
  if (*got == Got::not_yet && kY4mMagic.starts_with(bytes.substr(0, kY4mMagic.size()))) {
    if (stop.stop_requested())
      return fail(ErrorCode::interrupted, "stopped before a header came", where);
    return fail(ErrorCode::io,
                fmt::format("no whole header came within {} s", kHeaderWait.count() / 1000), where,
                "start the producer, and see whether it writes");
  }
  const bool whole = *got == Got::enough && length < kMaxY4mLine;
  auto header = parse_y4m_header(whole ? bytes.substr(0, length) : bytes, where);
  if (!whole && bytes.starts_with(kY4mMagic))
    return fail(ErrorCode::corrupt, "the header's line has no end", where);
  if (!header) return tl::unexpected(header.error());
  (*pipe)->take(length + 1);
  return std::make_unique<Y4mStream>(std::move(*pipe), std::move(*header), request, clock);
}

}  // namespace corvid
