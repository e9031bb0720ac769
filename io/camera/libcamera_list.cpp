#include <fmt/format.h>
#include <libcamera/camera.h>
#include <libcamera/camera_manager.h>
#include <libcamera/control_ids.h>
#include <libcamera/property_ids.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "core/log.h"
#include "io/camera/libcamera_camera.h"
#include "io/camera/libcamera_format.h"
#include "io/camera/libcamera_manager.h"
#include "io/camera/libcamera_setup.h"
#include "io/camera/raw_image.h"

namespace corvid {
namespace {

void add_note(std::string& note, const std::string& more) {
  if (!note.empty()) note += "; ";
  note += more;
}

/// The modes of one format: each size, or the largest one where sizes are a range.
std::vector<CameraMode> modes_of(const libcamera::StreamFormats& formats,
                                 const libcamera::PixelFormat& format) {
  std::vector<CameraMode> modes;
  CameraMode mode;
  mode.format = format.toString();
  const std::uint32_t fourcc = v4l2_fourcc_of(mode.format);
  if (fourcc == 0 || format_rank(fourcc) < 0) mode.note = "not understood";
  const libcamera::SizeRange range = formats.range(format);
  std::vector<libcamera::Size> sizes = formats.sizes(format);
  if (range.min != range.max && range.hStep != 0) {
    sizes = {range.max};
    add_note(mode.note, fmt::format("sizes from {} x {} on", range.min.width, range.min.height));
  }
  for (const libcamera::Size& size : sizes) {
    mode.width_px = static_cast<int>(size.width);
    mode.height_px = static_cast<int>(size.height);
    modes.push_back(mode);
  }
  return modes;
}

/// The rate that the camera can be set to, in all its modes.
void add_rates(const libcamera::Camera& camera, std::vector<CameraMode>& modes) {
  const libcamera::ControlInfoMap& controls = camera.controls();
  const auto limits = controls.find(&libcamera::controls::FrameDurationLimits);
  if (limits == controls.end()) return;
  const libcamera::ControlValue &shortest = limits->second.min(), &longest = limits->second.max();
  const auto is_number = [](const libcamera::ControlValue& value) {
    return value.type() == libcamera::ControlTypeInteger64 && !value.isArray() &&
           value.get<std::int64_t>() > 0;
  };
  if (!is_number(shortest) || !is_number(longest)) return;
  constexpr double kMicroseconds = 1e6;
  for (CameraMode& mode : modes) {
    mode.rates_hz = {kMicroseconds / static_cast<double>(shortest.get<std::int64_t>())};
    add_note(mode.note,
             fmt::format("rates from {:.4g} Hz on",
                         kMicroseconds / static_cast<double>(longest.get<std::int64_t>())));
  }
}

std::string driver_of(libcamera::CameraManager& manager, const libcamera::Camera& camera) {
  for (const std::filesystem::path& folder : device_folders(manager, camera)) {
    std::error_code error;
    const auto driver = std::filesystem::read_symlink(folder / "device" / "driver", error);
    if (!error) return driver.filename().string();
  }
  return "";
}

CameraListing listing_of(libcamera::CameraManager& manager, libcamera::Camera& camera) {
  CameraListing listing;
  listing.id = "libcamera:" + camera.id();
  listing.name = camera.properties().get(libcamera::properties::Model).value_or("");
  listing.driver = driver_of(manager, camera);
  if (const auto configuration = generate_configuration(camera)) {
    const libcamera::StreamFormats& formats = configuration->at(0).formats();
    for (const libcamera::PixelFormat& format : formats.pixelformats()) {
      std::vector<CameraMode> modes = modes_of(formats, format);
      listing.modes.insert(listing.modes.end(), modes.begin(), modes.end());
    }
    add_rates(camera, listing.modes);
  }
  if (const int status = camera.acquire(); status < 0) {
    listing.problem =
        status == -EBUSY ? "in use" : fmt::format("cannot be used: {}", std::strerror(-status));
  } else {
    camera.release();
  }
  return listing;
}

}  // namespace

std::vector<CameraListing> list_libcamera_cameras() {
  std::vector<CameraListing> listings;
  const auto manager = hold_camera_manager();
  if (!manager) {
    log().warn("{}", manager.error().to_string());
    return listings;
  }
  for (const std::shared_ptr<libcamera::Camera>& camera : (*manager)->cameras()) {
    listings.push_back(listing_of(**manager, *camera));
  }
  std::sort(listings.begin(), listings.end(),
            [](const CameraListing& a, const CameraListing& b) { return a.id < b.id; });
  return listings;
}

}  // namespace corvid
