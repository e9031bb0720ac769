#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "core/clock.h"
#include "io/camera/camera_stream.h"
#include "io/camera/v4l2_camera.h"
#include "vm/guest.h"

/// What tests of camera streams share.
namespace corvid::vm {

inline CameraRequest request_of(const std::string& node, const std::string& format = "",
                                int width_px = 0, int height_px = 0, double rate_hz = 0) {
  CameraRequest request;
  request.device = node;
  request.format = format;
  request.width_px = width_px;
  request.height_px = height_px;
  request.rate_hz = rate_hz;
  return request;
}

inline Clock& steady_clock() {
  static SteadyClock clock;
  return clock;
}

/// A stream that must open; nothing, with a failed test, if it does not.
inline std::unique_ptr<CameraStream> opened(const CameraRequest& request) {
  auto stream = open_v4l2(request, steady_clock());
  if (stream) return std::move(*stream);
  ADD_FAILURE() << stream.error().to_string();
  return nullptr;
}

/// The error of a stream that must not open.
inline Error refused(const CameraRequest& request) {
  auto stream = open_v4l2(request, steady_clock());
  if (!stream) return stream.error();
  ADD_FAILURE() << request.device << " was opened";
  return {};
}

/// The next picture, which must come.
inline Capture taken(CameraStream& stream) {
  auto picture = stream.next(kPatience, {});
  if (!picture) {
    ADD_FAILURE() << picture.error().to_string();
  } else if (!*picture) {
    ADD_FAILURE() << "no picture came";
  } else {
    return std::move(**picture);
  }
  return {};
}

/// The error with which a stream ends; pictures that come before are passed over.
inline Error end_of(CameraStream& stream) {
  for (int i = 0; i < 1000; ++i) {
    auto picture = stream.next(kPatience, {});
    if (!picture) return picture.error();
    if (!*picture) break;
  }
  ADD_FAILURE() << "the stream did not end";
  return {};
}

/// All of the settings' notes.
inline std::string notes_of(const CameraStream& stream) {
  std::string all;
  for (const std::string& note : stream.settings().notes) all += note + "\n";
  return all;
}

/// The listing of a node; nothing if it is not listed.
inline std::optional<CameraListing> listing_of(const std::string& node) {
  for (CameraListing& camera : list_v4l2_cameras()) {
    if (camera.id == "v4l2:" + node) return std::move(camera);
  }
  return std::nullopt;
}

}  // namespace corvid::vm
