#include "io/jpeg_header.h"

namespace corvid {
namespace {

using namespace std::string_view_literals;

unsigned byte_at(std::string_view bytes, std::size_t i) {
  return static_cast<unsigned char>(bytes[i]);
}

int word_at(std::string_view bytes, std::size_t i) {
  return static_cast<int>(byte_at(bytes, i) << 8 | byte_at(bytes, i + 1));
}

// Start of frame: C0 to CF but for those of tables (C4, CC) and C8.
bool starts_frame(unsigned marker) {
  return marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
}

}  // namespace

// Segments up to the scan; in a scan 0xFF is stuffed, so that the first FF D9 behind it is the end
// of the image (and not that of a thumbnail in the EXIF segment).
std::optional<JpegHeader> whole_jpeg_header(std::string_view bytes) {
  if (!bytes.starts_with("\xFF\xD8"sv)) return std::nullopt;
  std::optional<JpegHeader> header;
  std::size_t at = 2;
  while (at + 4 <= bytes.size()) {
    if (byte_at(bytes, at) != 0xFF) return std::nullopt;
    const unsigned marker = byte_at(bytes, at + 1);
    if (marker == 0xFF) {  // fill byte
      ++at;
      continue;
    }
    if (starts_frame(marker) && at + 9 <= bytes.size()) {
      header = JpegHeader{.width_px = word_at(bytes, at + 7), .height_px = word_at(bytes, at + 5)};
    }
    at += 2 + static_cast<std::size_t>(word_at(bytes, at + 2));
    if (marker == 0xDA) {
      const bool whole = at < bytes.size() && bytes.find("\xFF\xD9"sv, at) != bytes.npos;
      return whole ? header : std::nullopt;
    }
  }
  return std::nullopt;
}

}  // namespace corvid
