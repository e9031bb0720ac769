#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace corvid {

struct Rgb8 {
  std::uint8_t r = 0, g = 0, b = 0;
  bool operator==(const Rgb8&) const = default;
};

/// A row-major image without padding. Pixel (0,0) is the centre of the top-left pixel.
template <class T>
class Image {
 public:
  Image() = default;
  Image(int width_px, int height_px, T fill = T{})
      : width_(width_px),
        height_(height_px),
        data_(static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px), fill) {}

  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] bool empty() const { return data_.empty(); }
  [[nodiscard]] std::size_t size() const { return data_.size(); }
  [[nodiscard]] T* data() { return data_.data(); }
  [[nodiscard]] const T* data() const { return data_.data(); }
  [[nodiscard]] T* row(int y) { return data_.data() + offset(0, y); }
  [[nodiscard]] const T* row(int y) const { return data_.data() + offset(0, y); }
  /// Unchecked access.
  [[nodiscard]] T& operator()(int x, int y) { return data_[offset(x, y)]; }
  [[nodiscard]] const T& operator()(int x, int y) const { return data_[offset(x, y)]; }
  [[nodiscard]] bool contains(double x_px, double y_px, double border_px = 0) const {
    return x_px >= border_px && y_px >= border_px && x_px <= width_ - 1 - border_px &&
           y_px <= height_ - 1 - border_px;
  }
  bool operator==(const Image&) const = default;

 private:
  [[nodiscard]] std::size_t offset(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
           static_cast<std::size_t>(x);
  }
  int width_ = 0, height_ = 0;
  std::vector<T> data_;
};

using GreyImage = Image<std::uint8_t>;
using FloatImage = Image<float>;
using ColourImage = Image<Rgb8>;

}  // namespace corvid
