#pragma once

#include <memory>
#include <optional>
#include <stop_token>
#include <string>

#include "core/clock.h"
#include "corvid/error.h"
#include "io/camera/camera_source.h"
#include "io/camera/camera_stream.h"

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace corvid {

/// A camera as the command line names it: `v4l2:/dev/video0`, `libcamera:ID`, `y4m:-`.
struct CameraArguments {
  std::string spec;
  CameraRequest request;
  CameraSourceOptions source;
  std::string size;
  std::optional<double> exposure_ms;
  bool grey = false;

  /// Adds --camera, --size, --pixels, --camera-rate, --exposure, --gain and --duration to a
  /// command; returns --camera.
  CLI::Option* add_to(CLI::App& command);
  /// @param clock  outlives the source.
  /// @param stop   ends the wait for a stream that does not begin.
  [[nodiscard]] Expected<std::unique_ptr<CameraSource>> open(Clock& clock,
                                                             const std::stop_token& stop) const;
};

}  // namespace corvid
