#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "corvid/error.h"

namespace corvid {

/// What the first line of a YUV4MPEG2 stream says.
struct Y4mHeader {
  int width_px = 0, height_px = 0;
  std::int64_t rate_num = 0, rate_den = 0;  ///< frames per second; 0 : 0 where it does not say
  int chroma_width_px = 0, chroma_height_px = 0;  ///< 0: no chroma planes
  int bits = 8;                ///< of a sample; more than 8: two bytes, the lower first
  bool alpha = false;          ///< a plane like the luma's follows the chroma
  bool limited = true;         ///< luma 16..235; what it is if nobody says, but for 420jpeg
  bool unknown_order = false;  ///< `I?`: it does not say whether it is interlaced
  std::string colour;          ///< "420jpeg", "mono", ...

  [[nodiscard]] std::size_t sample_bytes() const { return bits > 8 ? 2 : 1; }
  [[nodiscard]] std::size_t luma_bytes() const;
  [[nodiscard]] std::size_t frame_bytes() const;
};

inline constexpr std::string_view kY4mMagic = "YUV4MPEG2";
/// The longest line that a header may be.
inline constexpr std::size_t kMaxY4mLine = 1024;

/// Reads the line, without its line feed. Every field is checked: width and height 1 to 16384 px,
/// the rate, the colour space (mono, 420, 411, 422, 444, their kinds and those of 9 to 16 bits).
/// Errors: corrupt (not such a line, a field that is missing or no number), unsupported (too large,
/// interlaced, another colour space).
[[nodiscard]] Expected<Y4mHeader> parse_y4m_header(std::string_view line, const std::string& where);

/// What the start of something that is no YUV4MPEG2 looks like: "Matroska", "MP4", "text".
[[nodiscard]] std::string looks_like(std::string_view bytes);

}  // namespace corvid
