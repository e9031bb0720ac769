#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace corvid {

/// sRGB transfer function (IEC 61966-2-1) between 8-bit sRGB and 16-bit linear light; a value
/// survives the way there and back.
[[nodiscard]] inline std::uint16_t srgb8_to_linear16(std::uint8_t value) {
  const double s = value / 255.0;
  const double linear = s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
  return static_cast<std::uint16_t>(std::lround(linear * 65535.0));
}
[[nodiscard]] inline std::uint8_t linear_to_srgb8(double linear) {
  if (!(linear > 0)) return 0;
  const double s = linear <= 0.0031308 ? linear * 12.92 : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
  return static_cast<std::uint8_t>(std::lround(std::min(s, 1.0) * 255.0));
}

}  // namespace corvid
