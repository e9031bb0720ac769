#pragma once

#include <optional>
#include <string_view>

namespace corvid {

/// What a JPEG's marker segments say (ITU T.81, annex B).
struct JpegHeader {
  int width_px = 0, height_px = 0;
};

/// Reads the segments of a JPEG and looks for the marker at its end. Nothing if it is no JPEG, or
/// is cut off: decoders fill such pictures with grey and say nothing. What stands behind the end
/// does not count: cameras send buffers of a fixed size.
[[nodiscard]] std::optional<JpegHeader> whole_jpeg_header(std::string_view bytes);

}  // namespace corvid
