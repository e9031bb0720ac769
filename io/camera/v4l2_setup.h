#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "corvid/error.h"
#include "io/camera/camera_stream.h"
#include "io/camera/v4l2_device.h"

namespace corvid {

/// The format that a device was set to.
struct V4l2Format {
  std::uint32_t fourcc = 0;
  int width_px = 0, height_px = 0;
  std::vector<std::size_t> strides_bytes;  ///< one per plane of a buffer
};

/// Sets the format, the rate, the exposure and the gain that are asked for, as open_v4l2() tells,
/// and reads them back. What differs goes into `settings.notes`.
[[nodiscard]] Expected<V4l2Format> set_up_v4l2(const V4l2Device& device,
                                               const CameraRequest& request,
                                               StreamSettings& settings);

}  // namespace corvid
