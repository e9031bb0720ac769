#include <fmt/format.h>
#include <poll.h>
#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <span>
#include <utility>

#include "io/camera/frame_count.h"
#include "io/camera/raw_image.h"
#include "io/camera/sensor_clock.h"
#include "io/camera/v4l2_camera.h"
#include "io/camera/v4l2_device.h"
#include "io/camera/v4l2_setup.h"

namespace corvid {
namespace {

/// Enough for a pause of a few pictures; a driver may give fewer.
constexpr std::uint32_t kBuffers = 8;
/// How long a wait lasts at most before it looks whether it is asked to stop.
constexpr int kWait_ms = 50;

/// A plane of a buffer, mapped into our memory.
class MappedPlane {
 public:
  MappedPlane(int fd, std::size_t size, std::int64_t offset)
      : size_(size), data_(::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, offset)) {}
  MappedPlane(MappedPlane&& other) noexcept
      : size_(other.size_), data_(std::exchange(other.data_, MAP_FAILED)) {}
  MappedPlane(const MappedPlane&) = delete;
  MappedPlane& operator=(const MappedPlane&) = delete;
  MappedPlane& operator=(MappedPlane&&) = delete;
  ~MappedPlane() {
    if (data_ != MAP_FAILED) ::munmap(data_, size_);
  }
  [[nodiscard]] bool mapped() const { return data_ != MAP_FAILED; }
  /// `used` bytes from `offset` on, within what is mapped.
  [[nodiscard]] std::span<const std::uint8_t> bytes(std::size_t offset, std::size_t used) const {
    const std::size_t end = std::min(size_, used);
    const std::size_t begin = std::min(end, offset);
    return {static_cast<const std::uint8_t*>(data_) + begin, end - begin};
  }

 private:
  std::size_t size_ = 0;
  void* data_ = MAP_FAILED;
};

/// A v4l2_buffer with the planes that it needs.
struct Buffer {
  v4l2_buffer head{};
  std::array<v4l2_plane, VIDEO_MAX_PLANES> planes{};

  Buffer(const V4l2Device& device, std::size_t index) {
    head.type = device.buffer_type();
    head.memory = V4L2_MEMORY_MMAP;
    head.index = static_cast<std::uint32_t>(index);
    if (device.multiplanar()) {
      head.m.planes = planes.data();
      head.length = planes.size();
    }
  }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;
};

class V4l2Stream final : public CameraStream {
 public:
  V4l2Stream(V4l2Device device, bool colour, Clock& clock)
      : device_(std::move(device)), colour_(colour), clock_(clock), sensor_clock_(device_.path()) {}
  ~V4l2Stream() override {
    int type = static_cast<int>(device_.buffer_type());
    if (streaming_) std::ignore = device_.call(VIDIOC_STREAMOFF, &type);
  }

  [[nodiscard]] Expected<void> start(const CameraRequest& request);
  [[nodiscard]] const StreamSettings& settings() const override { return settings_; }
  [[nodiscard]] Expected<std::optional<Capture>> next(std::chrono::milliseconds timeout,
                                                      const std::stop_token& stop) override;
  [[nodiscard]] StreamCounts counts() const override { return counts_.counts(); }

 private:
  [[nodiscard]] Expected<void> map_buffers();
  void note_times(const v4l2_buffer& buffer);
  [[nodiscard]] tl::unexpected<Error> over(int error, const std::string& what) const {
    return tl::unexpected(device_.fault(error, what));
  }
  [[nodiscard]] Expected<void> take_events() const;
  [[nodiscard]] Expected<std::optional<Capture>> take_buffer(bool in_error);
  [[nodiscard]] Expected<Capture> convert(const Buffer& buffer) const;

  V4l2Device device_;
  bool colour_;
  Clock& clock_;
  StreamSettings settings_;
  V4l2Format format_;
  std::vector<std::vector<MappedPlane>> buffers_;
  bool streaming_ = false;
  bool arrival_times_ = false;  ///< the driver does not say that its are of CLOCK_MONOTONIC
  SensorClock sensor_clock_;
  FrameCount counts_;
};

Expected<void> V4l2Stream::start(const CameraRequest& request) {
  Expected<V4l2Format> format = set_up_v4l2(device_, request, settings_);
  if (!format) return tl::unexpected(format.error());
  format_ = std::move(*format);
  if (auto ok = map_buffers(); !ok) return ok;
  v4l2_event_subscription change{};  // of the input that is in use
  if (int input = 0; device_.call(VIDIOC_G_INPUT, &input) == 0) {
    change.id = static_cast<std::uint32_t>(input);
  }
  change.type = V4L2_EVENT_SOURCE_CHANGE;
  std::ignore = device_.call(VIDIOC_SUBSCRIBE_EVENT, &change);  // most cameras have none
  int type = static_cast<int>(device_.buffer_type());
  if (const int error = device_.call(VIDIOC_STREAMON, &type)) {
    return over(error, error == ENOSPC || error == EPIPE
                           ? "the camera cannot start: its bus has no room left for this size "
                             "and rate (another port, or a smaller mode, may help)"
                           : "the camera cannot start");
  }
  streaming_ = true;
  return {};
}

Expected<void> V4l2Stream::map_buffers() {
  v4l2_requestbuffers wanted{};
  wanted.count = kBuffers;
  wanted.type = device_.buffer_type();
  wanted.memory = V4L2_MEMORY_MMAP;
  if (const int error = device_.call(VIDIOC_REQBUFS, &wanted)) {
    return over(error, "the camera gives no buffers");
  }
  for (std::uint32_t i = 0; i < wanted.count; ++i) {
    Buffer buffer(device_, i);
    if (const int error = device_.call(VIDIOC_QUERYBUF, &buffer.head)) {
      return over(error, fmt::format("buffer {} cannot be had", i));
    }
    std::vector<MappedPlane>& planes = buffers_.emplace_back();
    if (device_.multiplanar()) {
      for (std::uint32_t p = 0; p < buffer.head.length; ++p) {
        planes.emplace_back(device_.fd(), buffer.planes[p].length, buffer.planes[p].m.mem_offset);
      }
    } else {
      planes.emplace_back(device_.fd(), buffer.head.length, buffer.head.m.offset);
    }
    if (!std::all_of(planes.begin(), planes.end(), [](const auto& p) { return p.mapped(); })) {
      return over(errno, fmt::format("buffer {} cannot be mapped", i));
    }
    if (i == 0) note_times(buffer.head);
    if (const int error = device_.call(VIDIOC_QBUF, &buffer.head)) {
      return over(error, fmt::format("buffer {} cannot be queued", i));
    }
  }
  if (buffers_.empty()) return over(ENOMEM, "the camera gives no buffers");
  return {};
}

void V4l2Stream::note_times(const v4l2_buffer& buffer) {
  arrival_times_ =
      (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) != V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  if (arrival_times_) {
    settings_.notes.emplace_back(
        "the pictures' times are those of their arrival: the driver's clock is not known");
  }
}

Expected<std::optional<Capture>> V4l2Stream::next(std::chrono::milliseconds timeout,
                                                  const std::stop_token& stop) {
  const std::int64_t end_ns =
      clock_.now_ns() + std::chrono::duration_cast<std::chrono::nanoseconds>(timeout).count();
  while (!stop.stop_requested()) {
    const std::int64_t left_ms = (end_ns - clock_.now_ns() + 999'999) / 1'000'000;
    pollfd ready{.fd = device_.fd(), .events = POLLIN | POLLPRI, .revents = 0};
    const int wait_ms = static_cast<int>(std::clamp<std::int64_t>(left_ms, 0, kWait_ms));
    const int count = ::poll(&ready, 1, wait_ms);
    if (count < 0 && errno != EINTR) return over(errno, "the camera cannot be waited for");
    if (count > 0) {
      if ((ready.revents & POLLPRI) != 0) {
        if (auto ok = take_events(); !ok) return tl::unexpected(ok.error());
      }
      auto capture = take_buffer((ready.revents & (POLLERR | POLLHUP | POLLNVAL)) != 0);
      if (!capture || *capture) return capture;
    }
    if (left_ms <= 0) break;  // damaged pictures do not make the wait longer
  }
  return std::optional<Capture>();
}

// Only a change of the source is subscribed to.
Expected<void> V4l2Stream::take_events() const {
  v4l2_event event{};
  if (device_.call(VIDIOC_DQEVENT, &event) != 0) return {};
  return fail(ErrorCode::io,
              "the size or the rate of the camera's pictures has changed at its source",
              fmt::format("{} ({})", device_.path(), device_.name()), "it must be opened anew");
}

/// A buffer that is filled, as a picture; nothing if there is none, or a damaged one.
Expected<std::optional<Capture>> V4l2Stream::take_buffer(bool in_error) {
  Buffer buffer(device_, 0);
  if (const int error = device_.call(VIDIOC_DQBUF, &buffer.head)) {
    if (error == EAGAIN && !in_error) return std::optional<Capture>();
    v4l2_capability capability{};
    const bool gone = device_.call(VIDIOC_QUERYCAP, &capability) == ENODEV;
    return over(gone ? ENODEV : error == EAGAIN ? EIO : error, "the camera's stream broke off");
  }
  if (buffer.head.index >= buffers_.size()) {
    return over(EPROTO, "the driver gave a buffer that it does not have");
  }
  const std::int64_t arrival_ns = clock_.now_ns();
  const std::int64_t kernel_ns =
      std::clamp<std::int64_t>(buffer.head.timestamp.tv_sec, 0, 9'000'000'000) * 1'000'000'000 +
      std::int64_t{buffer.head.timestamp.tv_usec} * 1'000;
  const std::uint64_t sequence = counts_.came(buffer.head.sequence);
  Expected<Capture> capture = convert(buffer);
  if (const int error = device_.call(VIDIOC_QBUF, &buffer.head)) {
    return over(error, "a buffer cannot be queued again");
  }
  if (!capture) {
    counts_.damaged(sequence, capture.error().what);
    return std::optional<Capture>();
  }
  capture->time_ns =
      arrival_times_ ? arrival_ns : sensor_clock_.monotonic_ns(kernel_ns, arrival_ns, 0);
  capture->sequence = sequence;
  return std::optional<Capture>(std::move(*capture));
}

Expected<Capture> V4l2Stream::convert(const Buffer& buffer) const {
  if ((buffer.head.flags & V4L2_BUF_FLAG_ERROR) != 0) {
    return fail(ErrorCode::corrupt, "the driver says that it is faulty");
  }
  const std::vector<MappedPlane>& mapped = buffers_[buffer.head.index];
  std::array<RawPlane, VIDEO_MAX_PLANES> planes;
  const std::size_t count = std::min(mapped.size(), format_.strides_bytes.size());
  for (std::size_t i = 0; i < count; ++i) {
    const v4l2_plane& plane = buffer.planes[i];
    planes[i].bytes = device_.multiplanar() ? mapped[i].bytes(plane.data_offset, plane.bytesused)
                                            : mapped[i].bytes(0, buffer.head.bytesused);
    planes[i].stride_bytes = format_.strides_bytes[i];
  }
  Capture capture;
  auto ok = convert_raw(format_.fourcc, format_.width_px, format_.height_px,
                        std::span(planes).first(count), colour_, capture);
  if (!ok) return tl::unexpected(ok.error());
  return capture;
}

}  // namespace

Expected<std::unique_ptr<CameraStream>> open_v4l2(const CameraRequest& request, Clock& clock) {
  Expected<V4l2Device> device = V4l2Device::open(request.device);
  if (!device) return tl::unexpected(device.error());
  auto stream = std::make_unique<V4l2Stream>(std::move(*device), request.colour, clock);
  if (auto ok = stream->start(request); !ok) return tl::unexpected(ok.error());
  return stream;
}

}  // namespace corvid
