#include "io/image_encode.h"

#include <fmt/format.h>

#include <bit>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "core/check.h"

namespace corvid {
namespace {

cv::Mat view(const GreyImage& image) {
  return {image.height(), image.width(), CV_8UC1, const_cast<std::uint8_t*>(image.data())};
}

cv::Mat bgr(const ColourImage& image) {
  static_assert(sizeof(Rgb8) == 3);
  const cv::Mat rgb(image.height(), image.width(), CV_8UC3, const_cast<Rgb8*>(image.data()));
  cv::Mat out;
  cv::cvtColor(rgb, out, cv::COLOR_RGB2BGR);
  return out;
}

std::string encode(const char* extension, const cv::Mat& image,
                   const std::vector<int>& parameters) {
  CORVID_CHECK(!image.empty(), "an empty image cannot be encoded");
  std::vector<std::uint8_t> bytes;
  CORVID_CHECK(cv::imencode(extension, image, bytes, parameters), "the image encoder refused");
  return {bytes.begin(), bytes.end()};
}

}  // namespace

std::string encode_png(const GreyImage& image) { return encode(".png", view(image), {}); }

std::string encode_png(const ColourImage& image) {
  CORVID_CHECK(!image.empty(), "an empty image cannot be encoded");
  return encode(".png", bgr(image), {});
}

std::string encode_png(const ColourImage& image, const GreyImage& alpha) {
  CORVID_CHECK(!image.empty() && image.width() == alpha.width() && image.height() == alpha.height(),
               "image and alpha differ in size");
  const cv::Mat colour = bgr(image);
  cv::Mat out(colour.rows, colour.cols, CV_8UC4);
  const cv::Mat parts[2] = {colour, view(alpha)};
  cv::mixChannels(parts, 2, &out, 1, std::vector<int>{0, 0, 1, 1, 2, 2, 3, 3}.data(), 4);
  return encode(".png", out, {});
}

std::string encode_jpeg(const GreyImage& image, int quality) {
  return encode(".jpg", view(image), {cv::IMWRITE_JPEG_QUALITY, quality});
}

std::string encode_jpeg(const ColourImage& image, int quality) {
  CORVID_CHECK(!image.empty(), "an empty image cannot be encoded");
  return encode(".jpg", bgr(image), {cv::IMWRITE_JPEG_QUALITY, quality});
}

std::string encode_pfm(const FloatImage& image) {
  static_assert(std::endian::native == std::endian::little);
  std::string out = fmt::format("Pf\n{} {}\n-1.0\n", image.width(), image.height());
  for (int y = image.height() - 1; y >= 0; --y) {
    out.append(reinterpret_cast<const char*>(image.row(y)),
               static_cast<std::size_t>(image.width()) * sizeof(float));
  }
  return out;
}

}  // namespace corvid
