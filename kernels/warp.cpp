#include "kernels/warp.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <type_traits>
#include <utility>

#include "core/check.h"
#include "kernels/launch.h"
#include "kernels/program.h"

namespace corvid {
namespace {

// Channels of a pixel as an array of float.
std::array<float, 1> channels(std::uint8_t v) { return {static_cast<float>(v)}; }
std::array<float, 1> channels(float v) { return {v}; }
std::array<float, 3> channels(const Rgb8& v) {
  return {static_cast<float>(v.r), static_cast<float>(v.g), static_cast<float>(v.b)};
}
std::uint8_t to_byte(float v) { return static_cast<std::uint8_t>(std::lrint(v)); }
void assign(std::uint8_t& out, const std::array<float, 1>& v) { out = to_byte(v[0]); }
void assign(float& out, const std::array<float, 1>& v) { out = v[0]; }
void assign(Rgb8& out, const std::array<float, 3>& v) {
  out = {to_byte(v[0]), to_byte(v[1]), to_byte(v[2])};
}

// Also false for NaN.
bool readable(const WarpMap::Point& p, int width, int height) {
  return p.x_px >= 0 && p.y_px >= 0 && p.x_px <= static_cast<float>(width - 1) &&
         p.y_px <= static_cast<float>(height - 1);
}

template <class T>
Image<T> remap_on_host(const Image<T>& source, const WarpMap& map) {
  Image<T> out(map.width(), map.height());
  const int width = source.width(), height = source.height();
  for (int y = 0; y < map.height(); ++y) {
    for (int x = 0; x < map.width(); ++x) {
      const WarpMap::Point p = map.points()(x, y);
      if (!readable(p, width, height)) continue;
      const int x0 = static_cast<int>(p.x_px), y0 = static_cast<int>(p.y_px);
      const int x1 = std::min(x0 + 1, width - 1), y1 = std::min(y0 + 1, height - 1);
      const float fx = p.x_px - static_cast<float>(x0), fy = p.y_px - static_cast<float>(y0);
      auto value = channels(source(x0, y0));
      const auto right = channels(source(x1, y0)), below = channels(source(x0, y1)),
                 diagonal = channels(source(x1, y1));
      for (std::size_t c = 0; c < value.size(); ++c) {
        const float top = value[c] + fx * (right[c] - value[c]);
        const float bottom = below[c] + fx * (diagonal[c] - below[c]);
        value[c] = top + fy * (bottom - top);
      }
      assign(out(x, y), value);
    }
  }
  return out;
}

}  // namespace

WarpMap WarpMap::between(const Camera& from, const Camera& to, const Eigen::Matrix3d& R_from_to) {
  Image<Point> points(to.width_px, to.height_px);
  for (int y = 0; y < to.height_px; ++y) {
    for (int x = 0; x < to.width_px; ++x) {
      const auto ray = to.unproject({x, y});
      if (!ray) continue;
      const auto pixel = from.project(R_from_to * *ray);
      if (pixel && pixel->allFinite())
        points(x, y) = {static_cast<float>(pixel->x()), static_cast<float>(pixel->y())};
    }
  }
  return WarpMap(std::move(points));
}

WarpMap WarpMap::homography(const Eigen::Matrix3d& H_source_warped, int width_px, int height_px) {
  Image<Point> points(width_px, height_px);
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x) {
      const Eigen::Vector3d p = H_source_warped * Eigen::Vector3d(x, y, 1);
      if (p.z() > 0 && p.allFinite())
        points(x, y) = {static_cast<float>(p.x() / p.z()), static_cast<float>(p.y() / p.z())};
    }
  }
  return WarpMap(std::move(points));
}

GreyImage WarpMap::valid(int source_width_px, int source_height_px) const {
  GreyImage mask(width(), height());
  for (std::size_t i = 0; i < mask.size(); ++i)
    mask.data()[i] = readable(points_.data()[i], source_width_px, source_height_px) ? 255 : 0;
  return mask;
}

GreyImage remap(const GreyImage& source, const WarpMap& map) { return remap_on_host(source, map); }
FloatImage remap(const FloatImage& source, const WarpMap& map) {
  return remap_on_host(source, map);
}
ColourImage remap(const ColourImage& source, const WarpMap& map) {
  return remap_on_host(source, map);
}

Warper::Warper(std::shared_ptr<Device> device, cl::Kernel kernel)
    : device_(std::move(device)), kernel_(std::move(kernel)) {}

Expected<Warper> Warper::create(std::shared_ptr<Device> device, const std::string& extra_options) {
  const auto program = build_program(*device, "warp", extra_options);
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device, [&] {
    Warper warper(device, cl::Kernel(*program, "warp"));
    // Drivers compile for a launch shape at its first use: not in front of the first frame.
    const DeviceWarpMap map =
        warper.upload(WarpMap::homography(Eigen::Matrix3d::Identity(), 32, 32));
    (void)warper.remap(corvid::upload(*device, GreyImage(32, 32)), map);
    return warper;
  });
}

DeviceWarpMap Warper::upload(const WarpMap& map, Lane lane) {
  static_assert(sizeof(WarpMap::Point) == 2 * sizeof(float));
  CORVID_CHECK(map.width() > 0 && map.height() > 0, "a warp map has a size");
  const std::size_t bytes = map.points().size() * sizeof(WarpMap::Point);
  return on_device("warp map", [&] {
    DeviceWarpMap out{cl::Buffer(device_->context(), CL_MEM_READ_ONLY, bytes), map.width(),
                      map.height()};
    device_->queue(lane).enqueueWriteBuffer(out.points, CL_TRUE, 0, bytes, map.points().data());
    return out;
  });
}

DeviceImage Warper::remap(const DeviceImage& source, const DeviceWarpMap& map, Lane lane) {
  DeviceImage out = allocate_image(*device_, map.width_px, map.height_px);
  on_device("warp", [&] {
    set_arguments(kernel_, source.pixels, source.width_px, source.height_px, map.points, out.pixels,
                  out.width_px, out.height_px);
    launch_rows(*device_, lane, kernel_, map.width_px, map.height_px);
    device_->queue(lane).finish();
  });
  return out;
}

}  // namespace corvid
