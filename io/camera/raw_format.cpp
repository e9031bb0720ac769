#include "io/camera/raw_format.h"

#include <algorithm>
#include <array>
#include <opencv2/imgproc.hpp>
#include <string>
#include <string_view>
#include <utility>

#include "io/camera/raw_image.h"

namespace corvid {
namespace {

/// Of a name of four characters at most: "Y16" is "Y16 ".
constexpr std::uint32_t fourcc(std::string_view name) {
  std::uint32_t code = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    const char byte = i < name.size() ? name[i] : ' ';
    code |= static_cast<std::uint32_t>(static_cast<unsigned char>(byte)) << (8 * i);
  }
  return code;
}

constexpr RawFormat grey(std::uint32_t code, int rank, RawSample sample) {
  return {.fourcc = code, .kind = RawKind::grey, .rank = rank, .sample = sample};
}

constexpr RawFormat yuv422(std::uint32_t code, int luma, int to_rgb) {
  return {.fourcc = code, .kind = RawKind::yuv422, .rank = 2, .to_grey = luma, .to_rgb = to_rgb};
}

constexpr RawFormat yuv420(std::uint32_t code, int planes, bool split, bool v_first) {
  return {.fourcc = code,
          .kind = RawKind::yuv420,
          .rank = 1,
          .planes = planes,
          .split = split,
          .v_first = v_first};
}

constexpr RawFormat rgb(std::uint32_t code, int channels, int to_grey, int to_rgb) {
  return {.fourcc = code,
          .kind = RawKind::rgb,
          .rank = 5,
          .to_grey = to_grey,
          .to_rgb = to_rgb,
          .channels = channels};
}

/// OpenCV names a mosaic by the second row's second and third sample: RGGB is its BayerBG.
constexpr std::pair<int, int> kBggr = {cv::COLOR_BayerRG2GRAY, cv::COLOR_BayerRG2RGB};
constexpr std::pair<int, int> kGbrg = {cv::COLOR_BayerGR2GRAY, cv::COLOR_BayerGR2RGB};
constexpr std::pair<int, int> kGrbg = {cv::COLOR_BayerGB2GRAY, cv::COLOR_BayerGB2RGB};
constexpr std::pair<int, int> kRggb = {cv::COLOR_BayerBG2GRAY, cv::COLOR_BayerBG2RGB};

constexpr RawFormat bayer(std::uint32_t code, std::pair<int, int> order, RawSample sample) {
  return {.fourcc = code,
          .kind = RawKind::bayer,
          .rank = 4,
          .sample = sample,
          .to_grey = order.first,
          .to_rgb = order.second};
}

constexpr std::array kFormats = {
    grey(fourcc("GREY"), 0, RawSample::bits8),
    grey(fourcc("Y10 "), 3, RawSample::bits10),
    grey(fourcc("Y12 "), 3, RawSample::bits12),
    grey(fourcc("Y14 "), 3, RawSample::bits14),
    grey(fourcc("Y16 "), 3, RawSample::bits16),
    grey(fourcc("Y10P"), 3, RawSample::packed10),
    grey(fourcc("Y12P"), 3, RawSample::packed12),
    yuv422(fourcc("YUYV"), 0, cv::COLOR_YUV2RGB_YUYV),
    yuv422(fourcc("YVYU"), 0, cv::COLOR_YUV2RGB_YVYU),
    yuv422(fourcc("UYVY"), 1, cv::COLOR_YUV2RGB_UYVY),
    RawFormat{.fourcc = fourcc("VYUY"),
              .kind = RawKind::yuv422,
              .rank = 2,
              .to_grey = 1,
              .to_rgb = cv::COLOR_YUV2RGB_UYVY,
              .v_first = true},
    yuv420(fourcc("NV12"), 1, false, false),
    yuv420(fourcc("NV21"), 1, false, true),
    yuv420(fourcc("NM12"), 2, false, false),
    yuv420(fourcc("NM21"), 2, false, true),
    yuv420(fourcc("YU12"), 1, true, false),
    yuv420(fourcc("YV12"), 1, true, true),
    yuv420(fourcc("YM12"), 3, true, false),
    yuv420(fourcc("YM21"), 3, true, true),
    rgb(fourcc("RGB3"), 3, cv::COLOR_RGB2GRAY, -1),
    rgb(fourcc("BGR3"), 3, cv::COLOR_BGR2GRAY, cv::COLOR_BGR2RGB),
    rgb(fourcc("XR24"), 4, cv::COLOR_BGRA2GRAY, cv::COLOR_BGRA2RGB),
    rgb(fourcc("XB24"), 4, cv::COLOR_RGBA2GRAY, cv::COLOR_RGBA2RGB),
    bayer(fourcc("BA81"), kBggr, RawSample::bits8),
    bayer(fourcc("GBRG"), kGbrg, RawSample::bits8),
    bayer(fourcc("GRBG"), kGrbg, RawSample::bits8),
    bayer(fourcc("RGGB"), kRggb, RawSample::bits8),
    bayer(fourcc("BG10"), kBggr, RawSample::bits10),
    bayer(fourcc("GB10"), kGbrg, RawSample::bits10),
    bayer(fourcc("BA10"), kGrbg, RawSample::bits10),
    bayer(fourcc("RG10"), kRggb, RawSample::bits10),
    bayer(fourcc("pBAA"), kBggr, RawSample::packed10),
    bayer(fourcc("pGAA"), kGbrg, RawSample::packed10),
    bayer(fourcc("pgAA"), kGrbg, RawSample::packed10),
    bayer(fourcc("pRAA"), kRggb, RawSample::packed10),
    bayer(fourcc("BG12"), kBggr, RawSample::bits12),
    bayer(fourcc("GB12"), kGbrg, RawSample::bits12),
    bayer(fourcc("BA12"), kGrbg, RawSample::bits12),
    bayer(fourcc("RG12"), kRggb, RawSample::bits12),
    bayer(fourcc("pBCC"), kBggr, RawSample::packed12),
    bayer(fourcc("pGCC"), kGbrg, RawSample::packed12),
    bayer(fourcc("pgCC"), kGrbg, RawSample::packed12),
    bayer(fourcc("pRCC"), kRggb, RawSample::packed12),
    bayer(fourcc("BYR2"), kBggr, RawSample::bits16),
    bayer(fourcc("GB16"), kGbrg, RawSample::bits16),
    bayer(fourcc("GR16"), kGrbg, RawSample::bits16),
    bayer(fourcc("RG16"), kRggb, RawSample::bits16),
    RawFormat{.fourcc = fourcc("MJPG"), .kind = RawKind::jpeg, .rank = 6},
    RawFormat{.fourcc = fourcc("JPEG"), .kind = RawKind::jpeg, .rank = 6},
};

}  // namespace

const RawFormat* find_raw_format(std::uint32_t code) {
  const auto* at = std::find_if(kFormats.begin(), kFormats.end(),
                                [code](const RawFormat& format) { return format.fourcc == code; });
  return at == kFormats.end() ? nullptr : at;
}

std::string fourcc_name(std::uint32_t code) {
  std::string name;
  for (int i = 0; i < 4; ++i) {
    const auto byte = static_cast<char>(code >> (8 * i) & 0xFF);
    name += byte >= ' ' && byte <= '~' ? byte : '?';  // bit 31 marks big-endian variants
  }
  return name;
}

std::uint32_t fourcc_of(const std::string& name) {
  return name.empty() || name.size() > 4 ? 0 : fourcc(name);
}

int format_rank(std::uint32_t code) {
  const RawFormat* format = find_raw_format(code);
  return format ? format->rank : -1;
}

bool has_colour(std::uint32_t code) {
  const RawFormat* format = find_raw_format(code);
  return format && format->kind != RawKind::grey;
}

}  // namespace corvid
