#include "kernels/warp.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
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
ColourImage remap_colours(const Frame& frame, const Camera& lens, const WarpMap& map) {
  const auto fits = [&](const auto& image) {
    return image.width() == lens.width_px && image.height() == lens.height_px;
  };
  if (fits(frame.colour)) return remap(frame.colour, map);
  if (!fits(frame.grey)) return {};
  const GreyImage grey = remap(frame.grey, map);
  ColourImage out(grey.width(), grey.height());
  std::transform(grey.data(), grey.data() + grey.size(), out.data(), [](std::uint8_t g) {
    return Rgb8{g, g, g};
  });
  return out;
}

Eigen::Matrix3d homography_between(const Camera& from, const Camera& to,
                                   const Eigen::Matrix3d& R_from_to) {
  CORVID_CHECK(from.model == CameraModel::pinhole && to.model == CameraModel::pinhole,
               "only pinholes are related by a homography");
  return from.K() * R_from_to * to.K().inverse();
}

Warper::Warper(std::shared_ptr<Device> device, PixelFormat format, bool gpu,
               const cl::Program& program)
    : device_(std::move(device)), format_(format), gpu_(gpu), remap_(program, "remap") {
  const auto extensions = device_->device().getInfo<CL_DEVICE_EXTENSIONS>();
  if (extensions.find("cl_khr_fp64") != std::string::npos)
    homography_ = cl::Kernel(program, "homography");
}

Expected<Warper> Warper::create(std::shared_ptr<Device> device, const std::string& extra_options,
                                PixelFormat format, KernelKind kind) {
  const bool gpu = for_gpu(kind, *device);
  const auto program =
      build_program(*device, "warp",
                    format_options(format) + (gpu ? "-DLANES=1 " : "-DLANES=16 ") + extra_options);
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device, [&] {
    Warper warper(device, format, gpu, *program);
    // Drivers compile for a launch shape at its first use: not in front of the first frame.
    const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
    const DeviceImage image = allocate_image(*device, 32, 32, format);
    (void)warper.remap(image, warper.upload(WarpMap::homography(I, 32, 32)));
    (void)warper.warp(image, I, 32, 32);
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

template <class... Places>
DeviceImage Warper::run(cl::Kernel& kernel, const DeviceImage& source, int width_px, int height_px,
                        Lane lane, const Places&... places) {
  constexpr int kMinBand_px = 4096;
  CORVID_CHECK(source.format == format_, "a warper is for one format of image");
  CORVID_CHECK(source.height_px <= std::numeric_limits<int>::max() / source.width_px - 1,
               "places in the image are counted in int");
  DeviceImage out = allocate_image(*device_, width_px, height_px, format_);
  const int rows = gpu_ ? 1 : band_rows(*device_, width_px, height_px, kMinBand_px);
  on_device("warp", [&] {
    set_arguments(kernel, source.pixels, source.width_px, source.height_px, out.pixels, width_px,
                  height_px, rows, places...);
    if (gpu_)
      launch_rows(*device_, lane, kernel, width_px, height_px);
    else
      launch_items(*device_, lane, kernel, divide_up(height_px, rows));
    device_->queue(lane).finish();
  });
  return out;
}

DeviceImage Warper::remap(const DeviceImage& source, const DeviceWarpMap& map, Lane lane) {
  return run(remap_, source, map.width_px, map.height_px, lane, map.points);
}

DeviceImage Warper::warp(const DeviceImage& source, const Eigen::Matrix3d& H_source_warped,
                         int width_px, int height_px, Lane lane) {
  const Eigen::Matrix3d& H = H_source_warped;
  // A device without double precision gets a map.
  if (homography_() == nullptr)
    return remap(source, upload(WarpMap::homography(H, width_px, height_px), lane), lane);
  return run(homography_, source, width_px, height_px, lane, H(0, 0), H(0, 1), H(0, 2), H(1, 0),
             H(1, 1), H(1, 2), H(2, 0), H(2, 1), H(2, 2));
}

}  // namespace corvid
