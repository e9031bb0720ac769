#include "io/camera/libcamera_setup.h"

#include <fmt/format.h>
#include <libcamera/camera.h>
#include <libcamera/control_ids.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <optional>

#include "io/camera/libcamera_format.h"
#include "io/camera/raw_image.h"

namespace corvid {
namespace {

Expected<void> check(const CameraRequest& request) {
  const auto bad = [&](const std::string& what) {
    return fail(ErrorCode::invalid_argument, what, request.device);
  };
  constexpr int kLargest_px = 65535;
  if (request.width_px < 0 || request.height_px < 0 || request.width_px > kLargest_px ||
      request.height_px > kLargest_px || (request.width_px == 0) != (request.height_px == 0)) {
    return bad(fmt::format("{} x {} pixels is no size", request.width_px, request.height_px));
  }
  if (!std::isfinite(request.rate_hz) || request.rate_hz < 0) {
    return bad(fmt::format("{} Hz is no rate", request.rate_hz));
  }
  if (request.exposure_s && !(std::isfinite(*request.exposure_s) && *request.exposure_s > 0)) {
    return bad(fmt::format("{} s is no exposure", *request.exposure_s));
  }
  if (request.gain && !(std::isfinite(*request.gain) && *request.gain > 0)) {
    return bad(fmt::format("{} is no gain", *request.gain));
  }
  return {};
}

bool has_size(const libcamera::StreamFormats& formats, const libcamera::PixelFormat& format,
              const libcamera::Size& size) {
  if (size.isNull()) return true;
  const std::vector<libcamera::Size> sizes = formats.sizes(format);
  if (std::find(sizes.begin(), sizes.end(), size) != sizes.end()) return true;
  const libcamera::SizeRange range = formats.range(format);
  return range.hStep != 0 && range.vStep != 0 && range.contains(size);
}

std::optional<double> number(const libcamera::ControlValue& value) {
  if (value.isArray()) return std::nullopt;
  switch (value.type()) {
    case libcamera::ControlTypeInteger32:
      return value.get<std::int32_t>();
    case libcamera::ControlTypeInteger64:
      return static_cast<double>(value.get<std::int64_t>());
    case libcamera::ControlTypeFloat:
      return value.get<float>();
    default:
      return std::nullopt;
  }
}

/// `wanted`, within the control's limits; a note where they change it. `unit` is what one of the
/// user's units has of the control's.
double within_limits(const libcamera::ControlInfo& info, double wanted, double unit,
                     const char* name, const char* unit_name, std::vector<std::string>& notes) {
  const std::optional<double> low = number(info.min()), high = number(info.max());
  if (!low || !high || !(*low <= *high)) return wanted * unit;
  const double value = std::clamp(wanted * unit, *low, *high);
  if (value != wanted * unit) {
    notes.push_back(fmt::format(
        "The {} {}{} is outside of the camera's {} to {}{}; {}{} was taken.", name, wanted,
        unit_name, *low / unit, *high / unit, unit_name, value / unit, unit_name));
  }
  return value;
}

void plan_rate(const libcamera::ControlInfoMap& controls, double rate_hz,
               libcamera::ControlList& list, StreamSettings& settings) {
  const auto limits = controls.find(&libcamera::controls::FrameDurationLimits);
  if (limits == controls.end()) {
    settings.notes.push_back(
        fmt::format("libcamera cannot set this camera's rate; {} Hz was asked for.", rate_hz));
    return;
  }
  constexpr double kMicroseconds = 1e6;
  double wanted_us = kMicroseconds / rate_hz;
  const std::optional<double> low = number(limits->second.min());
  const std::optional<double> high = number(limits->second.max());
  if (low && high && *low > 0 && *low <= *high && (wanted_us < *low || wanted_us > *high)) {
    wanted_us = std::clamp(wanted_us, *low, *high);
    settings.notes.push_back(
        fmt::format("The rate {} Hz is outside of the camera's {:.4g} to {:.4g} Hz.", rate_hz,
                    kMicroseconds / *high, kMicroseconds / *low));
  }
  // A day is more than any camera's frame takes, and can be converted.
  const auto duration_us = static_cast<std::int64_t>(std::clamp(wanted_us, 1.0, 86400e6));
  const std::array<std::int64_t, 2> both = {duration_us, duration_us};
  list.set(libcamera::controls::FrameDurationLimits, libcamera::Span<const std::int64_t, 2>(both));
  settings.rate_hz = kMicroseconds / static_cast<double>(duration_us);
}

}  // namespace

std::unique_ptr<libcamera::CameraConfiguration> generate_configuration(libcamera::Camera& camera) {
  for (const auto role : {libcamera::StreamRole::Viewfinder, libcamera::StreamRole::VideoRecording,
                          libcamera::StreamRole::Raw}) {
    auto configuration = camera.generateConfiguration({role});
    if (configuration && !configuration->empty()) return configuration;
  }
  return nullptr;
}

Expected<LibcameraSetup> set_up_camera(libcamera::Camera& camera, const CameraRequest& request) {
  if (Expected<void> checked = check(request); !checked) return tl::unexpected(checked.error());
  LibcameraSetup setup;
  setup.configuration = generate_configuration(camera);
  if (!setup.configuration) {
    return fail(ErrorCode::unsupported, "the camera gives no stream of pictures", request.device);
  }
  libcamera::StreamConfiguration& stream = setup.configuration->at(0);
  const libcamera::Size wanted(static_cast<unsigned>(request.width_px),
                               static_cast<unsigned>(request.height_px));
  const std::vector<libcamera::PixelFormat> formats = stream.formats().pixelformats();
  std::vector<OfferedFormat> offered;
  for (const libcamera::PixelFormat& format : formats) {
    offered.push_back({format.toString(), has_size(stream.formats(), format, wanted)});
  }
  const Expected<std::size_t> chosen = choose_format(offered, request);
  if (!chosen) return tl::unexpected(chosen.error());
  const std::string chosen_name = offered[*chosen].name;
  stream.pixelFormat = formats[*chosen];
  if (!wanted.isNull()) stream.size = wanted;
  const auto refused = [&](int status) {
    return fail(ErrorCode::io,
                fmt::format("the camera cannot be set to {}: {}", stream.toString(),
                            std::strerror(-status)),
                request.device, status == -EBUSY ? "end the program that uses it" : "");
  };
  if (setup.configuration->validate() == libcamera::CameraConfiguration::Invalid) {
    return refused(-EINVAL);
  }
  if (const int status = camera.configure(setup.configuration.get()); status < 0) {
    return refused(status);
  }
  setup.settings.format = stream.pixelFormat.toString();
  setup.settings.width_px = static_cast<int>(stream.size.width);
  setup.settings.height_px = static_cast<int>(stream.size.height);
  setup.fourcc = v4l2_fourcc_of(setup.settings.format);
  setup.settings.colour = request.colour && has_colour(setup.fourcc);
  setup.stride_bytes = stream.stride;
  if (setup.settings.format != chosen_name) {
    setup.settings.notes.push_back(fmt::format("The camera took format {} instead of {}.",
                                               setup.settings.format, chosen_name));
  }
  if (!wanted.isNull() && stream.size != wanted) {
    setup.settings.notes.push_back(fmt::format("The camera took {} x {} pixels instead of {} x {}.",
                                               stream.size.width, stream.size.height, wanted.width,
                                               wanted.height));
  }
  return setup;
}

void plan_controls(const libcamera::Camera& camera, const CameraRequest& request,
                   libcamera::ControlList& first, libcamera::ControlList& then,
                   StreamSettings& settings) {
  const libcamera::ControlInfoMap& controls = camera.controls();
  std::vector<std::string>& notes = settings.notes;
  if (request.rate_hz > 0) plan_rate(controls, request.rate_hz, first, settings);
  if (request.exposure_s) {
    const auto exposure = controls.find(&libcamera::controls::ExposureTime);
    if (exposure == controls.end()) {
      notes.emplace_back("libcamera cannot set this camera's exposure; it is left as it is.");
    } else {
      if (controls.find(&libcamera::controls::AeEnable) != controls.end()) {
        first.set(libcamera::controls::AeEnable, false);
      }
      const double us =
          within_limits(exposure->second, *request.exposure_s, 1e6, "exposure", " s", notes);
      then.set(libcamera::controls::ExposureTime,
               static_cast<std::int32_t>(std::clamp(us, 1.0, 2e9)));
    }
  }
  if (request.gain) {
    const auto gain = controls.find(&libcamera::controls::AnalogueGain);
    if (gain == controls.end()) {
      notes.emplace_back("libcamera cannot set this camera's gain; it is left as it is.");
    } else {
      then.set(
          libcamera::controls::AnalogueGain,
          static_cast<float>(within_limits(gain->second, *request.gain, 1, "gain", "", notes)));
    }
  }
}

}  // namespace corvid
