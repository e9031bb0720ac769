#include <fmt/format.h>

#include "io/camera/raw_image.h"
#include "io/camera/v4l2_camera.h"
#include "io/camera/v4l2_device.h"

namespace corvid {
namespace {

std::vector<CameraMode> modes_of(const V4l2Device& device, std::uint32_t fourcc) {
  CameraMode mode;
  mode.format = fourcc_name(fourcc);
  if (format_rank(fourcc) < 0) {
    mode.note = "not understood";
    return {mode};
  }
  const V4l2Sizes sizes = device.sizes(fourcc);
  if (sizes.listed.empty()) return {mode};
  std::vector<CameraMode> modes;
  for (const auto& [width_px, height_px] : sizes.listed) {
    mode.width_px = width_px;
    mode.height_px = height_px;
    const V4l2Intervals intervals = device.intervals(fourcc, width_px, height_px);
    mode.rates_hz.clear();
    for (const v4l2_fract& interval : intervals.listed) {
      mode.rates_hz.push_back(rate_of(interval));
    }
    mode.note = intervals.range ? "every rate between" : "";
    if (sizes.range) {
      mode.note += fmt::format("{}sizes from {} x {} in steps of {} x {}",
                               mode.note.empty() ? "" : ", ", sizes.least_width_px,
                               sizes.least_height_px, sizes.step_width_px, sizes.step_height_px);
    }
    modes.push_back(mode);
  }
  return modes;
}

}  // namespace

std::vector<CameraListing> list_v4l2_cameras() {
  std::vector<CameraListing> cameras;
  for (const auto& [node, name] : v4l2_nodes()) {
    CameraListing camera;
    camera.id = "v4l2:" + node;
    camera.name = name;
    const Expected<V4l2Device> device = V4l2Device::open(node);
    if (!device) {
      // Nodes that do not capture are no cameras; one that is gone meanwhile is none any more.
      const ErrorCode code = device.error().code;
      if (code == ErrorCode::unsupported || code == ErrorCode::not_found) continue;
      camera.problem = device.error().to_string();
      cameras.push_back(std::move(camera));
      continue;
    }
    camera.name = device->name();
    camera.driver = device->driver();
    for (const std::uint32_t fourcc : device->formats()) {
      for (CameraMode& mode : modes_of(*device, fourcc)) camera.modes.push_back(std::move(mode));
    }
    if (device->in_use()) camera.problem = device->fault(EBUSY, "").to_string();
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

}  // namespace corvid
