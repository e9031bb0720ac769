#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "corvid/error.h"
#include "io/camera/camera_stream.h"

namespace corvid {

/// V4L2's FourCC of libcamera's format of that name ("R8", "BGR888", "SRGGB10_CSI2P"); 0 for
/// those that are not understood. libcamera names formats as DRM does, by little-endian words: the
/// bytes of its RGB888 are B, G, R.
[[nodiscard]] std::uint32_t v4l2_fourcc_of(const std::string& libcamera_name);

/// A format that a camera offers.
struct OfferedFormat {
  std::string name;       ///< libcamera's
  bool has_size = false;  ///< it comes in the size that is asked for, or none is asked for
};

/// The index of the format to take: the one that is asked for, else the best for grey pictures
/// (format_rank) among those that have the size; if colour is asked for, those with colour first.
/// Errors: unsupported (the camera does not offer it, or raw_image.h does not understand it, or
/// any).
[[nodiscard]] Expected<std::size_t> choose_format(std::span<const OfferedFormat> offered,
                                                  const CameraRequest& request);

}  // namespace corvid
