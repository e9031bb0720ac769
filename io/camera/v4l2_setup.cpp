#include "io/camera/v4l2_setup.h"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <optional>

#include "io/camera/raw_image.h"

namespace corvid {
namespace {

bool size_fits(const V4l2Sizes& sizes, int width_px, int height_px) {
  if (sizes.listed.empty()) return true;  // the driver does not say: it is asked by setting it
  if (!sizes.range) {
    return std::any_of(sizes.listed.begin(), sizes.listed.end(),
                       [&](const auto& size) { return size == std::pair(width_px, height_px); });
  }
  const auto& [most_width_px, most_height_px] = sizes.listed.front();
  return width_px >= sizes.least_width_px && width_px <= most_width_px &&
         height_px >= sizes.least_height_px && height_px <= most_height_px &&
         (width_px - sizes.least_width_px) % sizes.step_width_px == 0 &&
         (height_px - sizes.least_height_px) % sizes.step_height_px == 0;
}

bool rate_fits(const V4l2Intervals& intervals, double rate_hz) {
  if (intervals.listed.empty()) return true;
  const double fastest_hz = rate_of(intervals.listed.front());
  const double slowest_hz = rate_of(intervals.listed.back());
  if (intervals.range) return rate_hz <= 1.001 * fastest_hz && rate_hz >= 0.999 * slowest_hz;
  return std::any_of(intervals.listed.begin(), intervals.listed.end(), [&](const v4l2_fract& f) {
    return std::abs(rate_of(f) - rate_hz) <= 1e-3 * rate_hz;
  });
}

/// "GREY, YUYV (not understood: H264)".
std::string list_of(const std::vector<std::uint32_t>& formats) {
  std::string good, other;
  for (const std::uint32_t fourcc : formats) {
    std::string& list = format_rank(fourcc) < 0 ? other : good;
    list += (list.empty() ? "" : ", ") + fourcc_name(fourcc);
  }
  if (good.empty()) good = "none that is understood";
  return other.empty() ? good : fmt::format("{} (not understood: {})", good, other);
}

/// Reads and writes v4l2_format without regard to the number of planes.
struct Picture {
  v4l2_format format{};

  explicit Picture(const V4l2Device& device) { format.type = device.buffer_type(); }
  [[nodiscard]] bool multiplanar() const {
    return format.type == V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE;
  }
  [[nodiscard]] std::uint32_t fourcc() const {
    return multiplanar() ? format.fmt.pix_mp.pixelformat : format.fmt.pix.pixelformat;
  }
  [[nodiscard]] int width_px() const {
    return static_cast<int>(multiplanar() ? format.fmt.pix_mp.width : format.fmt.pix.width);
  }
  [[nodiscard]] int height_px() const {
    return static_cast<int>(multiplanar() ? format.fmt.pix_mp.height : format.fmt.pix.height);
  }
  [[nodiscard]] std::uint32_t field() const {
    return multiplanar() ? format.fmt.pix_mp.field : format.fmt.pix.field;
  }
  /// Whole pictures; the driver chooses how they lie in memory.
  void ask(std::uint32_t fourcc, int width_px, int height_px) {
    if (multiplanar()) {
      v4l2_pix_format_mplane& pix = format.fmt.pix_mp;
      pix = {};
      pix.pixelformat = fourcc;
      pix.width = static_cast<std::uint32_t>(width_px);
      pix.height = static_cast<std::uint32_t>(height_px);
      pix.field = V4L2_FIELD_NONE;
    } else {
      v4l2_pix_format& pix = format.fmt.pix;
      pix = {};
      pix.pixelformat = fourcc;
      pix.width = static_cast<std::uint32_t>(width_px);
      pix.height = static_cast<std::uint32_t>(height_px);
      pix.field = V4L2_FIELD_NONE;
    }
  }
  [[nodiscard]] std::vector<std::size_t> strides_bytes() const {
    if (!multiplanar()) return {format.fmt.pix.bytesperline};
    std::vector<std::size_t> strides;
    for (std::size_t i = 0; i < std::min<std::size_t>(format.fmt.pix_mp.num_planes, 8); ++i) {
      strides.push_back(format.fmt.pix_mp.plane_fmt[i].bytesperline);
    }
    return strides;
  }
};

/// The format to ask for: the requested one, or the best of those with the size and the rate.
Expected<std::uint32_t> choose_format(const V4l2Device& device, const CameraRequest& request,
                                      const Picture& now) {
  std::vector<std::uint32_t> formats = device.formats();
  if (formats.empty()) formats.push_back(now.fourcc());
  const auto refuse = [&](std::string what) {
    return fail(ErrorCode::unsupported, std::move(what),
                fmt::format("{} ({})", device.path(), device.name()),
                "it has: " + list_of(formats));
  };
  if (!request.format.empty()) {
    const std::uint32_t wanted = fourcc_of(request.format);
    if (std::find(formats.begin(), formats.end(), wanted) == formats.end()) {
      return refuse(fmt::format("the camera has no format {}", request.format));
    }
    if (format_rank(wanted) < 0) {
      return refuse(fmt::format("the format {} is not understood", request.format));
    }
    return wanted;
  }
  std::optional<std::uint32_t> best;
  std::pair<int, int> best_cost;
  for (const std::uint32_t fourcc : formats) {
    if (format_rank(fourcc) < 0) continue;
    const int width_px = request.width_px > 0 ? request.width_px : now.width_px();
    const int height_px = request.height_px > 0 ? request.height_px : now.height_px();
    int misses = 0;
    if (request.width_px > 0 && !size_fits(device.sizes(fourcc), width_px, height_px)) ++misses;
    if (request.rate_hz > 0 &&
        !rate_fits(device.intervals(fourcc, width_px, height_px), request.rate_hz)) {
      ++misses;
    }
    const std::pair cost(misses, format_rank(fourcc));
    if (!best || cost < best_cost) {
      best = fourcc;
      best_cost = cost;
    }
  }
  if (!best) return refuse("none of the camera's formats is understood");
  return *best;
}

Expected<V4l2Format> set_format(const V4l2Device& device, const CameraRequest& request,
                                StreamSettings& settings) {
  Picture picture(device);
  if (const int error = device.call(VIDIOC_G_FMT, &picture.format)) {
    return tl::unexpected(device.fault(error, "the camera does not tell its format"));
  }
  const Expected<std::uint32_t> fourcc = choose_format(device, request, picture);
  if (!fourcc) return tl::unexpected(fourcc.error());
  const int width_px = request.width_px > 0 ? request.width_px : picture.width_px();
  const int height_px = request.height_px > 0 ? request.height_px : picture.height_px();
  picture.ask(*fourcc, width_px, height_px);
  if (const int error = device.call(VIDIOC_S_FMT, &picture.format)) {
    return tl::unexpected(
        device.fault(error, fmt::format("the camera refuses {} x {} pixels in the format {}",
                                        width_px, height_px, fourcc_name(*fourcc))));
  }
  if (picture.fourcc() != *fourcc) {
    return fail(ErrorCode::unsupported,
                fmt::format("the camera was asked for the format {} and gives {}",
                            fourcc_name(*fourcc), fourcc_name(picture.fourcc())),
                fmt::format("{} ({})", device.path(), device.name()));
  }
  settings.format = fourcc_name(*fourcc);
  settings.colour = request.colour && has_colour(*fourcc);
  settings.width_px = picture.width_px();
  settings.height_px = picture.height_px();
  if (settings.width_px != width_px || settings.height_px != height_px) {
    settings.notes.push_back(fmt::format("{} x {} pixels were asked for, the camera gives {} x {}",
                                         width_px, height_px, settings.width_px,
                                         settings.height_px));
  }
  if (picture.field() != V4L2_FIELD_NONE && picture.field() != V4L2_FIELD_ANY) {
    settings.notes.emplace_back(
        "the camera's pictures are interlaced: two moments lie in every picture");
  }
  return V4l2Format{.fourcc = *fourcc,
                    .width_px = settings.width_px,
                    .height_px = settings.height_px,
                    .strides_bytes = picture.strides_bytes()};
}

/// The listed interval that is nearest to the rate, or else the rate itself as a fraction.
v4l2_fract nearest_interval(const V4l2Intervals& intervals, double rate_hz) {
  if (intervals.range || intervals.listed.empty()) return interval_of(rate_hz);
  return *std::min_element(intervals.listed.begin(), intervals.listed.end(),
                           [&](const v4l2_fract& a, const v4l2_fract& b) {
                             return std::abs(rate_of(a) - rate_hz) < std::abs(rate_of(b) - rate_hz);
                           });
}

void set_rate(const V4l2Device& device, double rate_hz, const V4l2Format& format,
              StreamSettings& settings) {
  v4l2_streamparm parameters{};
  parameters.type = device.buffer_type();
  const bool told = device.call(VIDIOC_G_PARM, &parameters) == 0;
  const v4l2_fract& interval = parameters.parm.capture.timeperframe;
  if (told) settings.rate_hz = rate_of(interval);
  if (rate_hz <= 0) return;
  if (!told || (parameters.parm.capture.capability & V4L2_CAP_TIMEPERFRAME) == 0) {
    settings.notes.push_back(
        fmt::format("{:.4g} Hz were asked for, but the camera's rate cannot be set", rate_hz));
    return;
  }
  parameters = {};
  parameters.type = device.buffer_type();
  parameters.parm.capture.timeperframe =
      nearest_interval(device.intervals(format.fourcc, format.width_px, format.height_px), rate_hz);
  if (const int error = device.call(VIDIOC_S_PARM, &parameters)) {
    settings.notes.push_back(
        device.fault(error, fmt::format("{:.4g} Hz are refused", rate_hz)).to_string());
    return;
  }
  settings.rate_hz = rate_of(interval);
  if (std::abs(settings.rate_hz - rate_hz) > 5e-4 * rate_hz) {
    settings.notes.push_back(fmt::format("{:.4g} Hz were asked for, the camera gives {:.4g} Hz",
                                         rate_hz, settings.rate_hz));
  }
}

/// The range of a control, if the device has it and it can be set.
std::optional<v4l2_queryctrl> control_range(const V4l2Device& device, std::uint32_t id) {
  v4l2_queryctrl range{};
  range.id = id;
  if (device.call(VIDIOC_QUERYCTRL, &range) != 0) return std::nullopt;
  if ((range.flags & (V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_READ_ONLY)) != 0) {
    return std::nullopt;
  }
  return range;
}

bool set_control(const V4l2Device& device, std::uint32_t id, int value) {
  v4l2_control control{.id = id, .value = value};
  return device.call(VIDIOC_S_CTRL, &control) == 0;
}

/// Sets a control to the value nearest to the one asked for, and tells in a note what it came to if
/// that is something else. `scale`: driver's units per unit of `value`.
void set_value(const V4l2Device& device, const v4l2_queryctrl& range, const std::string& name,
               double value, double scale, const std::string& unit, StreamSettings& settings) {
  // The limits first, in double: any value may be asked for.
  const double wanted = std::clamp(value * scale, static_cast<double>(range.minimum),
                                   static_cast<double>(range.maximum));
  if (!set_control(device, range.id, static_cast<int>(std::lround(wanted)))) {
    settings.notes.push_back(fmt::format("the camera refuses to set the {}", name));
    return;
  }
  v4l2_control got{.id = range.id, .value = 0};
  if (device.call(VIDIOC_G_CTRL, &got) != 0) return;
  if (std::abs(got.value - value * scale) >= 1) {
    settings.notes.push_back(fmt::format(
        "{} {:.6g}{} was asked for, the camera is at {:.6g}{} (its range: {:.6g} to {:.6g})", name,
        value, unit, got.value / scale, unit, range.minimum / scale, range.maximum / scale));
  }
}

void set_exposure(const V4l2Device& device, double exposure_s, StreamSettings& settings) {
  constexpr double kUnitsPerSecond = 1e4;  // V4L2_CID_EXPOSURE_ABSOLUTE: 100 us
  if (control_range(device, V4L2_CID_EXPOSURE_AUTO)) {
    set_control(device, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL);
  }
  if (const auto range = control_range(device, V4L2_CID_EXPOSURE_ABSOLUTE)) {
    set_value(device, *range, "exposure", exposure_s, kUnitsPerSecond, " s", settings);
  } else if (const auto lines = control_range(device, V4L2_CID_EXPOSURE)) {
    settings.notes.push_back(fmt::format(
        "the exposure is left as it is: the driver takes no seconds, but {} to {} of a unit that "
        "only it knows (v4l2-ctl -d {} -c exposure=N sets it)",
        lines->minimum, lines->maximum, device.path()));
  } else {
    settings.notes.emplace_back("the exposure is left as it is: the camera has no control for it");
  }
}

void set_gain(const V4l2Device& device, double gain, StreamSettings& settings) {
  if (control_range(device, V4L2_CID_AUTOGAIN)) set_control(device, V4L2_CID_AUTOGAIN, 0);
  for (const std::uint32_t id : {V4L2_CID_ANALOGUE_GAIN, V4L2_CID_GAIN}) {
    if (const auto range = control_range(device, id)) {
      set_value(device, *range, "gain", gain, 1, "", settings);
      return;
    }
  }
  settings.notes.emplace_back("the gain is left as it is: the camera has no control for it");
}

}  // namespace

Expected<V4l2Format> set_up_v4l2(const V4l2Device& device, const CameraRequest& request,
                                 StreamSettings& settings) {
  Expected<V4l2Format> format = set_format(device, request, settings);
  if (!format) return format;
  set_rate(device, request.rate_hz, *format, settings);
  if (request.exposure_s) set_exposure(device, *request.exposure_s, settings);
  if (request.gain) set_gain(device, *request.gain, settings);
  return format;
}

}  // namespace corvid
