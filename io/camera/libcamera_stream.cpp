#include <fmt/format.h>
#include <fmt/ranges.h>
#include <libcamera/camera.h>
#include <libcamera/camera_manager.h>
#include <libcamera/control_ids.h>
#include <libcamera/framebuffer_allocator.h>
#include <time.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <map>
#include <utility>

#include "core/log.h"
#include "io/camera/frame_count.h"
#include "io/camera/libcamera_camera.h"
#include "io/camera/libcamera_manager.h"
#include "io/camera/libcamera_session.h"
#include "io/camera/libcamera_setup.h"
#include "io/camera/mapped_buffer.h"
#include "io/camera/sensor_clock.h"
#include "io/nearest_name.h"

namespace corvid {
namespace {

/// CLOCK_BOOTTIME minus CLOCK_MONOTONIC.
std::int64_t slept_ns() {
  timespec monotonic = {}, boottime = {};
  clock_gettime(CLOCK_MONOTONIC, &monotonic);
  clock_gettime(CLOCK_BOOTTIME, &boottime);
  return (boottime.tv_sec - monotonic.tv_sec) * std::int64_t{1'000'000'000} + boottime.tv_nsec -
         monotonic.tv_nsec;
}

class LibcameraStream final : public CameraStream {
 public:
  /// Takes an acquired camera.
  LibcameraStream(std::shared_ptr<libcamera::CameraManager> manager,
                  std::shared_ptr<libcamera::Camera> camera, Clock& clock)
      : manager_(std::move(manager)),
        camera_(std::move(camera)),
        session_(camera_, device_folders(*manager_, *camera_), clock),
        sensor_clock_(camera_->id()) {}

  // libcamera reaches into requests and buffers until the session is closed.
  ~LibcameraStream() override {
    session_.close();
    requests_.clear();
    buffers_.clear();
    allocator_.reset();
    camera_->release();
  }

  Expected<void> start(const CameraRequest& request);
  [[nodiscard]] const StreamSettings& settings() const override { return setup_.settings; }
  [[nodiscard]] Expected<std::optional<Capture>> next(std::chrono::milliseconds timeout,
                                                      const std::stop_token& stop) override;
  [[nodiscard]] StreamCounts counts() const override { return count_.counts(); }

 private:
  tl::unexpected<Error> refused(const char* what, int status) const {
    return fail(ErrorCode::io, fmt::format("{}: {}", what, std::strerror(-status)), camera_->id(),
                status == -EBUSY ? "end the program that uses the camera" : "");
  }
  Expected<void> make_requests();
  Expected<void> on_cancelled(libcamera::Request& request);
  std::optional<Capture> take(const CompletedRequest& completed);

  std::shared_ptr<libcamera::CameraManager> manager_;
  std::shared_ptr<libcamera::Camera> camera_;
  LibcameraSession session_;
  LibcameraSetup setup_;
  libcamera::Stream* stream_ = nullptr;
  bool colour_ = false;
  std::unique_ptr<libcamera::FrameBufferAllocator> allocator_;
  std::map<const libcamera::FrameBuffer*, MappedBuffer> buffers_;
  std::vector<std::unique_ptr<libcamera::Request>> requests_;
  /// Requests that carry controls; a request that comes back does so no longer.
  std::vector<const libcamera::Request*> with_controls_;
  SensorClock sensor_clock_;
  FrameCount count_;
};

Expected<void> LibcameraStream::make_requests() {
  allocator_ = std::make_unique<libcamera::FrameBufferAllocator>(camera_);
  if (const int status = allocator_->allocate(stream_); status < 0) {
    return refused("the camera gives no buffers", status);
  }
  for (const auto& buffer : allocator_->buffers(stream_)) {
    Expected<MappedBuffer> mapped = MappedBuffer::map(*buffer);
    if (!mapped) {
      mapped.error().where = camera_->id();
      return tl::unexpected(mapped.error());
    }
    buffers_.emplace(buffer.get(), std::move(*mapped));
    std::unique_ptr<libcamera::Request> request = camera_->createRequest();
    if (!request) return refused("the camera makes no request", -ENODEV);
    if (const int status = request->addBuffer(stream_, buffer.get()); status < 0) {
      return refused("a request takes no buffer", status);
    }
    requests_.push_back(std::move(request));
  }
  if (requests_.empty()) return refused("the camera gives no buffers", -ENOMEM);
  return {};
}

Expected<void> LibcameraStream::start(const CameraRequest& request) {
  Expected<LibcameraSetup> setup = set_up_camera(*camera_, request);
  if (!setup) return tl::unexpected(setup.error());
  setup_ = std::move(*setup);
  stream_ = setup_.configuration->at(0).stream();
  colour_ = request.colour;
  if (Expected<void> made = make_requests(); !made) return made;

  // Some pipelines take controls at the start, others only with a request.
  libcamera::ControlList first(camera_->controls()), then(camera_->controls());
  plan_controls(*camera_, request, first, then, setup_.settings);
  libcamera::ControlList all = first;
  all.merge(then);
  session_.listen();
  if (const int status = camera_->start(&all); status < 0) {
    return refused("the camera does not start", status);
  }
  const auto give = [&](std::size_t index, const libcamera::ControlList& controls) {
    if (controls.empty() || index >= requests_.size()) return;
    requests_[index]->controls().merge(controls);
    with_controls_.push_back(requests_[index].get());
  };
  give(0, first);
  give(1, then);
  for (const auto& each : requests_) session_.queue(each.get());
  return {};
}

/// A camera refuses a request for its controls, or because it fails or is no longer there.
Expected<void> LibcameraStream::on_cancelled(libcamera::Request& request) {
  if (session_.is_gone()) return {};
  if (std::erase(with_controls_, &request) == 0) {
    return fail(ErrorCode::io, "the camera's driver has failed", camera_->id(),
                "open it anew; the system's log may say more");
  }
  log().warn("{}: the camera refused exposure, gain or rate: they are left as they are",
             camera_->id());
  return {};
}

std::optional<Capture> LibcameraStream::take(const CompletedRequest& completed) {
  const libcamera::FrameBuffer* buffer = completed.request->findBuffer(stream_);
  const libcamera::FrameMetadata& metadata = buffer->metadata();
  Capture capture;
  capture.sequence = count_.came(metadata.sequence);
  if (metadata.status != libcamera::FrameMetadata::FrameSuccess) {
    count_.damaged(capture.sequence, "flagged as faulty by the driver");
    return std::nullopt;
  }
  std::vector<std::size_t> bytes_used;
  for (const auto& plane : metadata.planes()) bytes_used.push_back(plane.bytesused);
  const MappedBuffer& memory = buffers_.at(buffer);
  std::uint32_t fourcc = setup_.fourcc;
  const std::vector<RawPlane> planes = memory.planes(bytes_used, setup_.stride_bytes, fourcc);
  memory.begin_read();
  const Expected<void> converted = convert_raw(fourcc, setup_.settings.width_px,
                                               setup_.settings.height_px, planes, colour_, capture);
  memory.end_read();
  if (!converted) {
    count_.damaged(capture.sequence, converted.error().to_string());
    return std::nullopt;
  }
  const std::optional<std::int64_t> stamp_ns =
      completed.request->metadata().get(libcamera::controls::SensorTimestamp);
  capture.time_ns =
      sensor_clock_.monotonic_ns(stamp_ns.value_or(0), completed.arrival_ns, slept_ns());
  return capture;
}

Expected<std::optional<Capture>> LibcameraStream::next(std::chrono::milliseconds timeout,
                                                       const std::stop_token& stop) {
  // Bounded, so that the deadline can be computed.
  const auto bounded = std::clamp<std::chrono::milliseconds>(timeout, std::chrono::milliseconds(0),
                                                             std::chrono::hours(24));
  const auto deadline = std::chrono::steady_clock::now() + bounded;
  while (const std::optional<CompletedRequest> completed = session_.wait(deadline, stop)) {
    std::optional<Capture> capture;
    if (completed->request->status() == libcamera::Request::RequestCancelled) {
      const Expected<void> goes_on = on_cancelled(*completed->request);
      if (!goes_on) return tl::unexpected(goes_on.error());
    } else {
      capture = take(*completed);
    }
    std::erase(with_controls_, completed->request);
    if (session_.is_gone()) break;
    completed->request->reuse(libcamera::Request::ReuseBuffers);
    session_.queue(completed->request);
    if (capture) return capture;
    // Damaged pictures do not make the wait longer.
    if (std::chrono::steady_clock::now() >= deadline) break;
  }
  if (session_.is_gone()) {
    return fail(ErrorCode::io, "the camera was unplugged", camera_->id(),
                "plug it in and open it anew");
  }
  return std::nullopt;
}

tl::unexpected<Error> no_such_camera(libcamera::CameraManager& manager, const std::string& id) {
  std::vector<std::string> ids;
  for (const auto& camera : manager.cameras()) ids.push_back(camera->id());
  std::sort(ids.begin(), ids.end());
  if (ids.empty()) {
    return fail(
        ErrorCode::not_found, "libcamera finds no camera at all", id,
        "it lists only what udev has announced and this user may open (group video), and of "
        "boards' cameras only those whose module of libcamera-ipa is installed; other "
        "cameras are opened as v4l2:/dev/video0");
  }
  const std::string nearest = nearest_hint(id, ids);
  return fail(
      ErrorCode::not_found, "no such camera", id,
      fmt::format("{}{}there are: {}", nearest, nearest.empty() ? "" : " ", fmt::join(ids, ", ")));
}

}  // namespace

Expected<std::unique_ptr<CameraStream>> open_libcamera(const CameraRequest& request, Clock& clock) {
  const auto manager = hold_camera_manager();
  if (!manager) return tl::unexpected(manager.error());
  std::shared_ptr<libcamera::Camera> camera = (*manager)->get(request.device);
  if (!camera) return no_such_camera(**manager, request.device);
  if (const int status = camera->acquire(); status < 0) {
    return fail(ErrorCode::io,
                status == -EBUSY
                    ? "the camera is in use"
                    : fmt::format("the camera cannot be had: {}", std::strerror(-status)),
                request.device, status == -EBUSY ? "end the program that uses it" : "");
  }
  auto stream = std::make_unique<LibcameraStream>(*manager, std::move(camera), clock);
  if (Expected<void> started = stream->start(request); !started) {
    return tl::unexpected(started.error());
  }
  return stream;
}

}  // namespace corvid
