#include "apps/camera_arguments.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <string_view>
#include <utility>

#include "apps/option_checks.h"
#include "io/camera/libcamera_camera.h"
#include "io/camera/v4l2_camera.h"
#include "io/camera/y4m_stream.h"

namespace corvid {
namespace {

using Open = Expected<std::unique_ptr<CameraStream>> (*)(const CameraRequest&, Clock&,
                                                         const std::stop_token&);

struct Kind {
  std::string_view prefix, name;
  Open open;
};

constexpr Kind kKinds[] = {
    {"v4l2:", "V4L2 camera",
     [](const CameraRequest& request, Clock& clock, const std::stop_token&) {
       return open_v4l2(request, clock);
     }},
    {"libcamera:", "libcamera",
     [](const CameraRequest& request, Clock& clock, const std::stop_token&) {
       return open_libcamera(request, clock);
     }},
    {"y4m:", "YUV4MPEG2 stream", open_y4m},
};

// "640x480".
Expected<void> parse_size(const std::string& text, CameraRequest& request) {
  if (text.empty()) return {};
  const char* const end = text.data() + text.size();
  const auto [cross, bad_width] = std::from_chars(text.data(), end, request.width_px);
  if (bad_width == std::errc() && cross != end && *cross == 'x') {
    const auto [rest, bad_height] = std::from_chars(cross + 1, end, request.height_px);
    if (bad_height == std::errc() && rest == end && request.width_px > 0 && request.height_px > 0)
      return {};
  }
  return fail(ErrorCode::invalid_argument, fmt::format("`{}` is no size", text), "--size",
              "width and height in pixels, such as 640x480");
}

}  // namespace

CLI::Option* CameraArguments::add_to(CLI::App& command) {
  CLI::Option* camera = command.add_option(
      "--camera", spec,
      "v4l2:DEVICE, libcamera:ID (`corvid cameras` lists both), or y4m:-, y4m:FIFO for a "
      "YUV4MPEG2 stream");
  command.add_option("--size", size, "WIDTHxHEIGHT [px]; default: what the camera is set to");
  command.add_option("--pixels", request.format,
                     "Pixel format as `corvid cameras` names it; default: the best for grey");
  command
      .add_option("--camera-rate", request.rate_hz,
                  "Frames per second; default: what the camera is set to")
      ->check(CLI::Range(0.01, 10000.0));
  command
      .add_option("--exposure", exposure_ms, "Manual exposure [ms]; default: the camera's own way")
      ->check(above(0));
  command
      .add_option("--gain", request.gain,
                  "Analogue gain: V4L2: in the driver's units; libcamera: a factor")
      ->check(at_least(0));
  command
      .add_option("--duration", source.duration_s,
                  "Ends by itself after so many seconds of capture")
      ->check(above(0));
  return camera;
}

Expected<std::unique_ptr<CameraSource>> CameraArguments::open(Clock& clock,
                                                              const std::stop_token& stop) const {
  CameraRequest wanted = request;
  if (auto size_ok = parse_size(size, wanted); !size_ok) return tl::unexpected(size_ok.error());
  if (exposure_ms) wanted.exposure_s = *exposure_ms * 1e-3;
  wanted.colour = !grey;
  for (const Kind& kind : kKinds) {
    if (!spec.starts_with(kind.prefix)) continue;
    wanted.device = spec.substr(kind.prefix.size());
    // Plugged in again, a camera has its own first size, and not the one that it was set to.
    auto opener = [open = kind.open, wanted, &clock, stop]() mutable {
      auto stream = open(wanted, clock, stop);
      if (stream && wanted.width_px == 0) {
        wanted.width_px = (*stream)->settings().width_px;
        wanted.height_px = (*stream)->settings().height_px;
      }
      return stream;
    };
    return CameraSource::open(std::string(kind.name), wanted.device, std::move(opener), source,
                              clock);
  }
  return fail(ErrorCode::invalid_argument, fmt::format("`{}` names no camera", spec), "--camera",
              spec.starts_with("/dev/")
                  ? "v4l2:" + spec
                  : "v4l2:/dev/video0, libcamera:ID or y4m:-; `corvid cameras` lists them");
}

}  // namespace corvid
