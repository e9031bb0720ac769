#include "apps/report_pictures.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "core/check.h"
#include "io/image_encode.h"

namespace corvid {
namespace {

/// Colours of values in [0, 1] by an OpenCV table; alpha 0 where `known` is 0.
MeshPicture colourise(const cv::Mat& values, const cv::Mat& known, int table) {
  cv::Mat bytes, bgr;
  values.convertTo(bytes, CV_8UC1, 255.0);
  cv::applyColorMap(bytes, bgr, table);
  MeshPicture out{ColourImage(values.cols, values.rows), GreyImage(values.cols, values.rows)};
  cv::Mat rgb(values.rows, values.cols, CV_8UC3, out.colour.data());
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  known.copyTo(cv::Mat(values.rows, values.cols, CV_8UC1, out.alpha.data()));
  return out;
}

cv::Mat view(const FloatImage& image) {
  return {image.height(), image.width(), CV_32FC1, const_cast<float*>(image.data())};
}

template <class T>
Image<T> shrink_image(const Image<T>& image, int type, int max_width_px) {
  if (image.width() <= max_width_px) return image;
  const int height = std::max(1, static_cast<int>(std::lround(static_cast<double>(image.height()) *
                                                              max_width_px / image.width())));
  const cv::Mat source(image.height(), image.width(), type, const_cast<T*>(image.data()));
  Image<T> out(max_width_px, height);
  cv::Mat target(height, max_width_px, type, out.data());
  cv::resize(source, target, target.size(), 0, 0, cv::INTER_AREA);
  return out;
}

double quantile(std::vector<double>& values, double share) {
  const auto nth =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

}  // namespace

std::vector<std::size_t> spread_indices(std::size_t size, std::size_t count) {
  std::vector<std::size_t> out;
  count = std::min(size, count);
  for (std::size_t i = 0; i < count; ++i) {
    out.push_back(count == 1 ? size / 2 : i * (size - 1) / (count - 1));
  }
  return out;
}

DepthPicture picture_of_depth(const FloatImage& depth) {
  CORVID_CHECK(!depth.empty(), "a depth map without pixels");
  DepthPicture out;
  std::vector<double> inverse;
  for (std::size_t i = 0; i < depth.size(); ++i) {
    const float z = depth.data()[i];
    if (z > 0 && std::isfinite(z)) inverse.push_back(1.0 / z);
  }
  double low = 0, high = 1;
  if (!inverse.empty()) {
    low = quantile(inverse, 0.02);
    high = quantile(inverse, 0.98);
    out.far = 1 / low;
    out.near = 1 / high;
  }
  const double size = std::max(high - low, 1e-12);
  cv::Mat values(depth.height(), depth.width(), CV_32FC1);
  cv::Mat known(depth.height(), depth.width(), CV_8UC1);
  for (int y = 0; y < depth.height(); ++y) {
    for (int x = 0; x < depth.width(); ++x) {
      const float z = depth(x, y);
      const bool answer = z > 0 && std::isfinite(z);
      known.at<std::uint8_t>(y, x) = answer ? 255 : 0;
      // The table's ends are nearly black; the middle 90 % is used.
      values.at<float>(y, x) =
          answer ? static_cast<float>(0.05 + 0.9 * std::clamp((1.0 / z - low) / size, 0.0, 1.0))
                 : 0;
    }
  }
  out.picture = colourise(values, known, cv::COLORMAP_TURBO);
  return out;
}

MeshPicture picture_of_confidence(const FloatImage& confidence) {
  CORVID_CHECK(!confidence.empty(), "a confidence map without pixels");
  const cv::Mat values = view(confidence);
  const cv::Mat known = values > 0;  // false for NaN too
  cv::Mat clamped;
  cv::min(cv::max(values, 0.0f), 1.0f, clamped);
  clamped.setTo(0, ~known);
  return colourise(clamped, known, cv::COLORMAP_VIRIDIS);
}

MeshPicture shrink(MeshPicture picture, int max_width_px) {
  if (picture.colour.width() <= max_width_px) return picture;
  // Nearest neighbour in blocks would flicker and averages would bleed the empty pixels' black in:
  // colours are averaged weighted by alpha.
  const int w = picture.colour.width(), h = picture.colour.height();
  const cv::Mat rgb(h, w, CV_8UC3, picture.colour.data()),
      alpha(h, w, CV_8UC1, picture.alpha.data());
  cv::Mat weight, weights, colour;
  alpha.convertTo(weight, CV_32FC1, 1.0 / 255);
  cv::merge(std::vector<cv::Mat>{weight, weight, weight}, weights);
  rgb.convertTo(colour, CV_32FC3);
  colour = colour.mul(weights);
  const int height = std::max(1, static_cast<int>(std::lround(double(h) * max_width_px / w)));
  const cv::Size size(max_width_px, height);
  cv::resize(colour, colour, size, 0, 0, cv::INTER_AREA);
  cv::resize(weight, weight, size, 0, 0, cv::INTER_AREA);
  cv::merge(std::vector<cv::Mat>{weight, weight, weight}, weights);
  cv::Mat divided = colour / cv::max(weights, 1e-3);
  MeshPicture out{ColourImage(size.width, size.height), GreyImage(size.width, size.height)};
  cv::Mat out_colour(size, CV_8UC3, out.colour.data()), out_alpha(size, CV_8UC1, out.alpha.data());
  divided.convertTo(out_colour, CV_8UC3);
  weight.convertTo(out_alpha, CV_8UC1, 255.0);
  return out;
}

ColourImage shrink(const ColourImage& image, int max_width_px) {
  return shrink_image(image, CV_8UC3, max_width_px);
}

ColourImage grey_as_colour(const GreyImage& image) {
  ColourImage out(image.width(), image.height());
  for (std::size_t i = 0; i < image.size(); ++i) {
    const std::uint8_t v = image.data()[i];
    out.data()[i] = {v, v, v};
  }
  return out;
}

std::optional<PlotPicture> picture_of_landmarks(const Landmarks& landmarks,
                                                const std::vector<Eigen::Vector2d>& path,
                                                const ViewAxes& axes) {
  std::vector<double> x, y;
  for (const Landmark& l : landmarks) {
    if (!l.p_world.allFinite()) continue;
    const Eigen::Vector2d p = axes.top(l.p_world);
    x.push_back(p.x());
    y.push_back(p.y());
  }
  if (x.empty()) return std::nullopt;
  PlotPicture out;
  out.low = {quantile(x, 0.01), quantile(y, 0.01)};
  out.high = {quantile(x, 0.99), quantile(y, 0.99)};
  for (const Eigen::Vector2d& p : path) {
    if (!p.allFinite()) continue;
    out.low = out.low.cwiseMin(p);
    out.high = out.high.cwiseMax(p);
  }
  const double margin = std::max(0.04 * (out.high - out.low).maxCoeff(), 1e-6);
  out.low.array() -= margin;
  out.high.array() += margin;

  const Eigen::Vector2d size = out.high - out.low;
  const double scale = std::min(1300 / size.x(), 1000 / size.y());
  const int width = std::max(static_cast<int>(size.x() * scale), 2);
  const int height = std::max(static_cast<int>(size.y() * scale), 2);
  ColourImage image(width, height, Rgb8{22, 25, 29});
  const int dot = x.size() < 8000 ? 3 : 2;
  for (const Landmark& l : landmarks) {
    if (!l.p_world.allFinite()) continue;
    const Eigen::Vector2d p = (axes.top(l.p_world) - out.low) * scale;
    const int px = static_cast<int>(std::clamp(p.x(), -9.0, 1e4));
    const int py = height - 1 - static_cast<int>(std::clamp(p.y(), -9.0, 1e4));
    // Dark landmarks would vanish on the dark ground.
    const auto lift = [](std::uint8_t v) { return static_cast<std::uint8_t>(70 + v * 185 / 255); };
    const Rgb8 colour{lift(l.colour.r), lift(l.colour.g), lift(l.colour.b)};
    for (int dy = 0; dy < dot; ++dy) {
      for (int dx = 0; dx < dot; ++dx) {
        if (image.contains(px + dx, py + dy)) image(px + dx, py + dy) = colour;
      }
    }
  }
  out.png = encode_png(image);
  return out;
}

}  // namespace corvid
