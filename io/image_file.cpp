#include "io/image_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <exception>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string_view>

#include "io/atomic_file.h"
#include "io/jpeg_header.h"
#include "io/readers/text.h"

namespace corvid {
namespace {

using namespace std::string_view_literals;

unsigned byte_at(std::string_view bytes, std::size_t i) {
  return static_cast<unsigned char>(bytes[i]);
}

// PNG specification, 5.3: chunks of length, type, data, CRC; the last one is IEND.
bool png_is_whole(std::string_view bytes) {
  std::size_t at = 8;
  while (at + 12 <= bytes.size()) {
    const std::size_t length = byte_at(bytes, at) << 24 | byte_at(bytes, at + 1) << 16 |
                               byte_at(bytes, at + 2) << 8 | byte_at(bytes, at + 3);
    if (bytes.substr(at + 4, 4) == "IEND"sv) return true;
    if (length > bytes.size()) return false;
    at += length + 12;
  }
  return false;
}

bool is_whole(std::string_view bytes) {
  if (bytes.starts_with("\x89PNG\r\n\x1A\n"sv)) return png_is_whole(bytes);
  if (bytes.starts_with("\xFF\xD8"sv)) return whole_jpeg_header(bytes).has_value();
  return true;
}

cv::Mat decode(const std::string& bytes) {
  try {
    const cv::Mat raw(1, static_cast<int>(bytes.size()), CV_8U, const_cast<char*>(bytes.data()));
    return cv::imdecode(raw,
                        cv::IMREAD_ANYCOLOR | cv::IMREAD_ANYDEPTH | cv::IMREAD_IGNORE_ORIENTATION);
  } catch (const std::exception&) {  // OpenCV's own, or no memory for an absurd size
    return {};
  }
}

}  // namespace

Expected<DecodedImage> read_image(const std::string& path, bool colour) {
  const Expected<std::string> bytes = read_file_bytes(path);
  if (!bytes) return tl::unexpected(bytes.error());
  if (bytes->empty()) return fail(ErrorCode::corrupt, "the image file is empty", path);
  if (bytes->size() > std::size_t{1} << 30) {
    return fail(ErrorCode::unsupported, "the image file is larger than 1 GiB", path);
  }
  if (!is_whole(*bytes)) {
    return fail(ErrorCode::corrupt,
                fmt::format("the image is cut off: the file ends after {} bytes", bytes->size()),
                path);
  }
  cv::Mat image = decode(*bytes);
  if (image.empty()) return fail(ErrorCode::corrupt, "the image cannot be decoded", path);
  if (image.depth() == CV_16U) image.convertTo(image, CV_8U, 1.0 / 256, -0.499);  // upper byte
  if (image.depth() != CV_8U || (image.channels() != 1 && image.channels() != 3)) {
    return fail(ErrorCode::unsupported, "only images with 8 or 16 bits per channel can be used",
                path);
  }
  DecodedImage result;
  result.grey = GreyImage(image.cols, image.rows);
  cv::Mat grey(image.rows, image.cols, CV_8UC1, result.grey.data());
  if (image.channels() == 1) {
    image.copyTo(grey);
    return result;
  }
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  if (colour) {
    result.colour = ColourImage(image.cols, image.rows);
    static_assert(sizeof(Rgb8) == 3);
    cv::Mat rgb(image.rows, image.cols, CV_8UC3, result.colour.data());
    cv::cvtColor(image, rgb, cv::COLOR_BGR2RGB);
  }
  return result;
}

bool is_image_name(const std::string& name) {
  static constexpr std::array kEndings = {".jpg"sv,  ".jpeg"sv, ".png"sv, ".bmp"sv, ".tif"sv,
                                          ".tiff"sv, ".pgm"sv,  ".ppm"sv, ".webp"sv};
  if (name.starts_with('.')) return false;  // hidden files, and what macOS leaves on other disks
  const std::string lower = lower_case(name);
  return std::any_of(kEndings.begin(), kEndings.end(),
                     [&](std::string_view ending) { return lower.ends_with(ending); });
}

}  // namespace corvid
