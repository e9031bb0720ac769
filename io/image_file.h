#pragma once

#include <string>

#include "corvid/error.h"
#include "corvid/image.h"

namespace corvid {

struct DecodedImage {
  GreyImage grey;      ///< BT.601 luma of a colour image
  ColourImage colour;  ///< empty for a grey image, or where colour was not asked for
};

/// Reads a PNG, JPEG, BMP, TIFF, WebP or PGM/PPM file. 16-bit images give their upper 8 bits.
/// Pixels come as they are stored: the EXIF orientation is not applied, because calibrations are of
/// the stored image. Errors: not_found, io, corrupt (a file that ends too early too, where the
/// decoder alone would give half a picture).
[[nodiscard]] Expected<DecodedImage> read_image(const std::string& path, bool colour = true);

/// True for a name that ends in an extension that read_image() knows.
[[nodiscard]] bool is_image_name(const std::string& name);

}  // namespace corvid
