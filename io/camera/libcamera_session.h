#pragma once

// Internal to libcamera_*.cpp: the one header here that needs libcamera's.
#include <libcamera/base/object.h>

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <vector>

#include "core/clock.h"

namespace libcamera {
class Camera;
class Request;
}  // namespace libcamera

namespace corvid {

/// A request that came back from the camera.
struct CompletedRequest {
  libcamera::Request* request = nullptr;
  std::int64_t arrival_ns = 0;
};

/// What a stream does on the thread of libcamera's manager, and the queue by which finished
/// requests leave it.
///
/// Everything that changes the camera's state runs on that thread, in one piece with libcamera's
/// own part of it, because libcamera 0.0.3 ends the process where the two fall apart: a request
/// that reaches a camera after it was unplugged, or a stop that the driver refuses because the
/// device is no longer there, runs into its assertions.
class LibcameraSession final : public libcamera::Object {
 public:
  /// @param folders  device_folders() of the camera.
  LibcameraSession(std::shared_ptr<libcamera::Camera> camera,
                   std::vector<std::filesystem::path> folders, Clock& clock);

  /// Begins to listen to the camera, before it starts.
  void listen();
  /// Hands a request to the camera, soon.
  void queue(libcamera::Request* request);
  /// Stops the camera and its calls; on return no request is in its hands, or none is touched any
  /// more.
  void close();

  /// The next request that came back, cancelled ones among them; nothing at the deadline, when
  /// asked to stop, or when the camera was unplugged.
  [[nodiscard]] std::optional<CompletedRequest> wait(std::chrono::steady_clock::time_point deadline,
                                                     const std::stop_token& stop);
  /// Whether the camera was unplugged, as libcamera says or the system.
  [[nodiscard]] bool is_gone();

 private:
  void queue_here(libcamera::Request* request);
  void flush_here();
  void close_here();
  void on_completed(libcamera::Request* request);
  void on_disconnected();

  std::shared_ptr<libcamera::Camera> camera_;
  std::vector<std::filesystem::path> folders_;
  Clock& clock_;
  bool listening_ = false;
  std::mutex mutex_;
  std::condition_variable_any changed_;
  std::deque<CompletedRequest> completed_;
  bool disconnected_ = false;
};

}  // namespace corvid
