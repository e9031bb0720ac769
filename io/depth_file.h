#pragma once

#include <string>

#include "corvid/error.h"
#include "corvid/image.h"

namespace corvid {

/// Reads a depth camera's image: 16-bit PNG in millimetres, 0 and 65535 where nothing was measured.
/// @return metres, 0 where nothing was measured. Errors: not_found, io, corrupt (no 16-bit image of
///         one channel).
[[nodiscard]] Expected<FloatImage> read_depth_image(const std::string& path);

}  // namespace corvid
