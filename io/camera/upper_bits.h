#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace corvid {

/// The upper 8 of each of `count` samples of which `bits` are used: little-endian words of 16 bits
/// with the sample in their lower ones. A larger value is white.
inline void take_upper_bits(const std::uint8_t* words, std::size_t count, int bits,
                            std::uint8_t* out) {
  for (std::size_t i = 0; i < count; ++i) {
    const int value = words[2 * i] | words[2 * i + 1] << 8;
    out[i] = static_cast<std::uint8_t>(std::min(value >> (bits - 8), 255));
  }
}

}  // namespace corvid
