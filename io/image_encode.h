#pragma once

#include <string>

#include "corvid/image.h"

namespace corvid {

/// Image files as bytes. The image must not be empty (CORVID_CHECK).
[[nodiscard]] std::string encode_png(const GreyImage& image);
[[nodiscard]] std::string encode_png(const ColourImage& image);
/// With transparency: alpha has the image's size, 0 is see-through.
[[nodiscard]] std::string encode_png(const ColourImage& image, const GreyImage& alpha);
/// @param quality  1 to 100.
[[nodiscard]] std::string encode_jpeg(const GreyImage& image, int quality);
[[nodiscard]] std::string encode_jpeg(const ColourImage& image, int quality);
/// Portable float map: 32-bit floats, little-endian, bottom row first.
[[nodiscard]] std::string encode_pfm(const FloatImage& image);

}  // namespace corvid
