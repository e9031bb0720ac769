#include "io/undistort.h"

#include <opencv2/imgproc.hpp>

#include "core/check.h"

namespace corvid {
namespace {

template <class T>
Image<T> remap(const Image<T>& image, const FloatImage& map_x, const FloatImage& map_y, int type) {
  const cv::Mat source(image.height(), image.width(), type, const_cast<T*>(image.data()));
  const cv::Mat x(map_x.height(), map_x.width(), CV_32FC1, const_cast<float*>(map_x.data()));
  const cv::Mat y(map_y.height(), map_y.width(), CV_32FC1, const_cast<float*>(map_y.data()));
  Image<T> out(map_x.width(), map_x.height());
  cv::Mat target(out.height(), out.width(), type, out.data());
  cv::remap(source, target, x, y, cv::INTER_CUBIC, cv::BORDER_CONSTANT);
  return out;
}

}  // namespace

Undistorter::Undistorter(const Camera& camera)
    : from_(camera), to_(camera.undistorted()), identity_(to_ == from_) {
  if (identity_) return;
  map_x_ = FloatImage(to_.width_px, to_.height_px, -1e6f);
  map_y_ = FloatImage(to_.width_px, to_.height_px, -1e6f);
  for (int y = 0; y < to_.height_px; ++y) {
    for (int x = 0; x < to_.width_px; ++x) {
      const auto ray = to_.unproject({x, y});
      const auto source = ray ? from_.project(*ray) : std::nullopt;
      if (!source || !from_.in_image(*source, -1)) continue;
      map_x_(x, y) = static_cast<float>(source->x());
      map_y_(x, y) = static_cast<float>(source->y());
    }
  }
}

GreyImage Undistorter::operator()(const GreyImage& image) const {
  CORVID_CHECK(image.width() == from_.width_px && image.height() == from_.height_px,
               "the image is not of this camera");
  return identity_ ? image : remap(image, map_x_, map_y_, CV_8UC1);
}

ColourImage Undistorter::operator()(const ColourImage& image) const {
  CORVID_CHECK(image.width() == from_.width_px && image.height() == from_.height_px,
               "the image is not of this camera");
  return identity_ ? image : remap(image, map_x_, map_y_, CV_8UC3);
}

std::optional<Eigen::Vector2d> Undistorter::pixel(const Eigen::Vector2d& distorted) const {
  if (identity_) return distorted;
  const auto ray = from_.unproject(distorted);
  return ray ? to_.project(*ray) : std::nullopt;
}

}  // namespace corvid
