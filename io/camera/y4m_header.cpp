#include "io/camera/y4m_header.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <optional>
#include <utility>

#include "io/readers/text.h"

namespace corvid {
namespace {

constexpr std::int64_t kMaxSide_px = 16384;

using namespace std::string_view_literals;

// "30000:1001"
std::optional<std::pair<std::int64_t, std::int64_t>> ratio(std::string_view text) {
  const std::size_t colon = text.find(':');
  if (colon == std::string_view::npos) return {};
  const auto num = to_integer(text.substr(0, colon)), den = to_integer(text.substr(colon + 1));
  constexpr std::int64_t kMost = 1'000'000'000;  // times nanoseconds it fits 64 bits
  if (!num || !den || *num < 0 || *den < 0 || *num > kMost || *den > kMost) return {};
  return std::pair(*num, *den);
}

// Chroma and depth of "mono", "420jpeg", "444p10", ...; false: not known.
bool set_colour(std::string_view name, Y4mHeader& header) {
  header.colour = name;
  int across = 0, down = 0;  // how many luma samples share one of chroma
  std::string_view rest;
  if (name.starts_with("mono")) {
    rest = name.substr(4);
    if (!rest.empty()) {
      const auto bits = to_integer(rest);
      if (!bits || *bits < 9 || *bits > 16) return false;
      header.bits = static_cast<int>(*bits);
    }
    return true;
  }
  if (name.starts_with("420")) across = 2, down = 2;
  if (name.starts_with("411")) across = 4, down = 1;
  if (name.starts_with("422")) across = 2, down = 1;
  if (name.starts_with("444")) across = 1, down = 1;
  if (across == 0) return false;
  rest = name.substr(3);
  if (name == "444alpha") {
    header.alpha = true;
  } else if (name == "420jpeg") {
    header.limited = false;
  } else if (rest.starts_with('p') && rest != "paldv"sv) {
    const auto bits = to_integer(rest.substr(1));
    if (!bits || *bits < 9 || *bits > 16) return false;
    header.bits = static_cast<int>(*bits);
  } else if (!rest.empty() && !(across * down == 4 && (rest == "paldv"sv || rest == "mpeg2"sv))) {
    return false;
  }
  header.chroma_width_px = (header.width_px + across - 1) / across;
  header.chroma_height_px = (header.height_px + down - 1) / down;
  return true;
}

}  // namespace

std::size_t Y4mHeader::luma_bytes() const {
  return static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px) * sample_bytes();
}

std::size_t Y4mHeader::frame_bytes() const {
  const std::size_t chroma = static_cast<std::size_t>(chroma_width_px) *
                             static_cast<std::size_t>(chroma_height_px) * sample_bytes();
  return luma_bytes() * (alpha ? 2 : 1) + 2 * chroma;
}

Expected<Y4mHeader> parse_y4m_header(std::string_view line, const std::string& where) {
  const std::vector<std::string_view> parts = fields(line, " ");
  if (parts.empty() || parts[0] != kY4mMagic) {
    return fail(ErrorCode::corrupt,
                fmt::format("this is no YUV4MPEG2 stream; it looks like {}", looks_like(line)),
                where, "let ffmpeg make one: ffmpeg -i INPUT -f yuv4mpegpipe -");
  }
  const auto wrong = [&](std::string_view part, const char* expected) {
    return fail(ErrorCode::corrupt,
                fmt::format("the stream's header has `{}`: expected {}", part, expected), where);
  };
  Y4mHeader header;
  std::string_view colour = "420jpeg";
  std::optional<bool> limited;
  for (std::size_t i = 1; i < parts.size(); ++i) {
    const std::string_view part = parts[i], value = part.substr(1);
    switch (part[0]) {
      case 'W':
      case 'H': {
        const auto number = to_integer(value);
        if (!number || *number < 1) return wrong(part, "a number of pixels");
        if (*number > kMaxSide_px) {
          return fail(ErrorCode::unsupported,
                      fmt::format("the stream's header has `{}`: pictures may have {} px at most",
                                  part, kMaxSide_px),
                      where, "scale it down: ffmpeg -vf scale=1280:-2");
        }
        (part[0] == 'W' ? header.width_px : header.height_px) = static_cast<int>(*number);
        break;
      }
      case 'F': {
        const auto rate = ratio(value);
        if (!rate) return wrong(part, "frames per second as F30:1");
        if (rate->first > 0 && rate->second > 0 &&
            (rate->first / 1'000'000 > rate->second || rate->second / 1000 > rate->first)) {
          return wrong(part, "0.001 to 1e6 frames per second");
        }
        if (rate->first > 0 && rate->second > 0) {
          header.rate_num = rate->first;
          header.rate_den = rate->second;
        }
        break;
      }
      case 'A':
        if (!ratio(value)) return wrong(part, "the shape of a pixel as A1:1");
        break;
      case 'I':
        if (value.size() != 1 || std::string_view("ptbm?").find(value[0]) == value.npos)
          return wrong(part, "Ip, It, Ib, Im or I?");
        if (value != "p"sv && value != "?"sv) {
          return fail(ErrorCode::unsupported, "the stream is interlaced", where,
                      "let ffmpeg make whole pictures of it: -vf yadif");
        }
        header.unknown_order = value == "?"sv;
        break;
      case 'C':
        colour = value;
        break;
      case 'X':
        if (value == "COLORRANGE=FULL"sv) limited = false;
        if (value == "COLORRANGE=LIMITED"sv) limited = true;
        break;
      default:
        return wrong(part, "fields that begin with W, H, F, I, A, C or X");
    }
  }
  if (header.width_px == 0 || header.height_px == 0) {
    return fail(ErrorCode::corrupt, "the stream's header names no width and height (W, H)", where);
  }
  if (!set_colour(colour, header)) {
    return fail(ErrorCode::unsupported, fmt::format("the colour space {} is not known", colour),
                where, "let ffmpeg convert it: -pix_fmt gray or yuv420p");
  }
  header.limited = limited.value_or(header.limited);
  return header;
}

std::string looks_like(std::string_view bytes) {
  const auto at = [&](std::size_t offset, std::string_view what) {
    return bytes.size() >= offset + what.size() && bytes.substr(offset, what.size()) == what;
  };
  if (bytes.empty()) return "nothing: it is empty";
  if (at(0, "\x1A\x45\xDF\xA3")) return "Matroska or WebM";
  if (at(4, "ftyp")) return "MP4 or QuickTime";
  if (at(0, "RIFF")) return "AVI (RIFF)";
  if (at(0, "\xFF\xD8\xFF")) return "JPEG or MJPEG";
  if (at(0, "\x89PNG")) return "PNG";
  if (at(0, "\0\0\0\1"sv) || at(0, "\0\0\1"sv)) return "raw H.264, HEVC or MPEG";
  if (at(0, "OggS")) return "Ogg";
  if (at(0, "FLV")) return "FLV";
  if (at(0, "\x1F\x8B")) return "gzip";
  if (at(0, "G") && (bytes.size() <= 188 || bytes[188] == 'G') && !at(0, "GIF")) {
    return "an MPEG transport stream";
  }
  if (at(0, "FRAME")) return "the middle of a YUV4MPEG2 stream: its header is missing";
  if (kY4mMagic.starts_with(bytes.substr(0, kY4mMagic.size())))
    return "a YUV4MPEG2 stream that is cut off";
  const std::string_view start = bytes.substr(0, 64);
  if (std::all_of(start.begin(), start.end(), [](char c) {
        return std::isprint(static_cast<unsigned char>(c)) != 0 ||
               std::isspace(static_cast<unsigned char>(c)) != 0;
      })) {
    return fmt::format("text (`{}`)",
                       trim(start.substr(0, std::min<std::size_t>(start.find('\n'), 32))));
  }
  return "raw bytes";
}

}  // namespace corvid
