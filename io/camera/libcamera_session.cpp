#include "io/camera/libcamera_session.h"

#include <libcamera/camera.h>
#include <libcamera/request.h>

#include <utility>

#include "core/log.h"
#include "io/camera/libcamera_manager.h"

namespace corvid {

LibcameraSession::LibcameraSession(std::shared_ptr<libcamera::Camera> camera,
                                   std::vector<std::filesystem::path> folders, Clock& clock)
    : camera_(std::move(camera)), folders_(std::move(folders)), clock_(clock) {}

void LibcameraSession::listen() {
  moveToThread(camera_->thread());
  camera_->requestCompleted.connect(this, &LibcameraSession::on_completed);
  camera_->disconnected.connect(this, &LibcameraSession::on_disconnected);
  listening_ = true;
}

void LibcameraSession::queue(libcamera::Request* request) {
  invokeMethod(&LibcameraSession::queue_here, libcamera::ConnectionTypeQueued, request);
}

void LibcameraSession::close() {
  if (!listening_) return;
  // Two messages: libcamera's parts of what was queued stand between them.
  invokeMethod(&LibcameraSession::flush_here, libcamera::ConnectionTypeBlocking);
  invokeMethod(&LibcameraSession::close_here, libcamera::ConnectionTypeBlocking);
  listening_ = false;
}

// libcamera's own part of queueing is a message to the same thread. It follows this one before the
// thread looks for devices that were unplugged.
void LibcameraSession::queue_here(libcamera::Request* request) {
  if (const int status = camera_->queueRequest(request); status < 0) {
    log().debug("libcamera takes no request: {}", status);
  }
}

void LibcameraSession::flush_here() {}

void LibcameraSession::close_here() {
  camera_->requestCompleted.disconnect(this);
  camera_->disconnected.disconnect(this);
  if (!is_gone()) camera_->stop();
}

void LibcameraSession::on_completed(libcamera::Request* request) {
  const std::int64_t arrival_ns = clock_.now_ns();
  {
    const std::scoped_lock lock(mutex_);
    completed_.push_back({request, arrival_ns});
  }
  changed_.notify_all();
}

void LibcameraSession::on_disconnected() {
  {
    const std::scoped_lock lock(mutex_);
    disconnected_ = true;
  }
  changed_.notify_all();
}

std::optional<CompletedRequest> LibcameraSession::wait(
    std::chrono::steady_clock::time_point deadline, const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  changed_.wait_until(lock, stop, deadline, [&] { return disconnected_ || !completed_.empty(); });
  if (disconnected_ || stop.stop_requested() || completed_.empty()) return std::nullopt;
  const CompletedRequest request = completed_.front();
  completed_.pop_front();
  return request;
}

bool LibcameraSession::is_gone() {
  {
    const std::scoped_lock lock(mutex_);
    if (disconnected_) return true;
  }
  return !is_plugged_in(folders_);
}

}  // namespace corvid
