#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "corvid/error.h"
#include "io/camera/camera_stream.h"

namespace corvid {

/// V4L2's FourCC as text ("YUYV", "Y16 "), and back; 0 if it has not one to four characters.
[[nodiscard]] std::string fourcc_name(std::uint32_t fourcc);
[[nodiscard]] std::uint32_t fourcc_of(const std::string& name);

/// One plane of a raw picture.
struct RawPlane {
  std::span<const std::uint8_t> bytes;  ///< as many as the driver says were filled
  std::size_t stride_bytes = 0;         ///< from row to row; 0 for compressed pictures
};

/// How well a format suits grey pictures: 0 for the best, rising; negative if it is not understood.
[[nodiscard]] int format_rank(std::uint32_t fourcc);

/// Whether pictures of a format come with colour, when it is asked for.
[[nodiscard]] bool has_colour(std::uint32_t fourcc);

/// Makes the grey picture (and the colour one, if it is asked for and the format has it) of a
/// Capture. 16-bit formats keep their upper 8 significant bits; luma of limited range is taken as
/// it is; a Bayer mosaic becomes the interpolated grey.
/// @param fourcc  V4L2's.
/// @param planes  one, or one per plane where the driver keeps them apart (NM12).
/// Errors: unsupported (the format), corrupt (too few bytes for the size, a JPEG that cannot be
/// decoded or has another size). Then `out` is unchanged.
[[nodiscard]] Expected<void> convert_raw(std::uint32_t fourcc, int width_px, int height_px,
                                         std::span<const RawPlane> planes, bool colour,
                                         Capture& out);

}  // namespace corvid
