#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

/// Pictures that carry their number, in a way that JPEG does not destroy: the emulated camera sends
/// them, the tests check them.
namespace corvid::vm {

constexpr int kBit_px = 8;  ///< the number is written in the topmost rows, a square per bit

/// A ramp along the diagonal, up and down, that moves with the number.
inline std::uint8_t ramp(int x, int y, std::uint32_t number) {
  const std::uint32_t phase = (static_cast<std::uint32_t>(x + y) + 4 * number) % 512;
  return static_cast<std::uint8_t>(phase < 256 ? phase : 511 - phase);
}

/// The luma of a pixel of picture `number`. Wide enough for the 32 bits: 256 px or more.
inline std::uint8_t numbered_luma(int x, int y, std::uint32_t number) {
  const int bit = x / kBit_px;
  if (y >= kBit_px || bit >= 32) return ramp(x, y, number);
  return (number >> bit & 1) != 0 ? 255 : 0;
}

inline std::vector<std::uint8_t> numbered_picture(int width_px, int height_px,
                                                  std::uint32_t number) {
  std::vector<std::uint8_t> luma;
  luma.reserve(static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px));
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x) luma.push_back(numbered_luma(x, y, number));
  }
  return luma;
}

/// The number of a picture whose rows have `width_px` bytes of luma.
inline std::uint32_t number_in(const std::uint8_t* luma, int width_px) {
  std::uint32_t number = 0;
  for (int bit = 0; bit < 32; ++bit) {
    const int at = width_px * (kBit_px / 2) + bit * kBit_px + kBit_px / 2;
    if (luma[at] >= 128) number |= 1u << bit;
  }
  return number;
}

}  // namespace corvid::vm
