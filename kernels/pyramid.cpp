#include "kernels/pyramid.h"

#include <algorithm>
#include <atomic>
#include <utility>

#include "kernels/launch.h"
#include "kernels/program.h"

namespace corvid {
namespace {

std::size_t pixel_count(int width_px, int height_px) {
  return static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
}

}  // namespace

DeviceImage allocate_image(const Device& device, int width_px, int height_px, PixelFormat format) {
  CORVID_CHECK(width_px > 0 && height_px > 0, "an image has a size");
  static std::atomic<std::uint64_t> images{0};
  const std::size_t pixel_bytes = format == PixelFormat::grey8 ? 1 : sizeof(float);
  return on_device("image", [&] {
    return DeviceImage{
        cl::Buffer(device.context(), CL_MEM_READ_WRITE,
                   pixel_count(width_px, height_px) * pixel_bytes + DeviceImage::kImagePadding),
        width_px, height_px, format, ++images};
  });
}

namespace {

template <class Pixel>
DeviceImage upload_pixels(const Device& device, const Image<Pixel>& image, PixelFormat format,
                          Lane lane) {
  DeviceImage out = allocate_image(device, image.width(), image.height(), format);
  on_device("image upload", [&] {
    device.queue(lane).enqueueWriteBuffer(out.pixels, CL_TRUE, 0, image.size() * sizeof(Pixel),
                                          image.data());
  });
  return out;
}

}  // namespace

DeviceImage upload(const Device& device, const GreyImage& image, Lane lane) {
  return upload_pixels(device, image, PixelFormat::grey8, lane);
}

DeviceImage upload(const Device& device, const FloatImage& image, Lane lane) {
  return upload_pixels(device, image, PixelFormat::float32, lane);
}

namespace {

template <class Pixel>
Image<Pixel> download_pixels(const Device& device, const DeviceImage& image, Lane lane) {
  Image<Pixel> out(image.width_px, image.height_px);
  on_device("image download", [&] {
    device.queue(lane).enqueueReadBuffer(image.pixels, CL_TRUE, 0, out.size() * sizeof(Pixel),
                                         out.data());
  });
  return out;
}

}  // namespace

GreyImage download(const Device& device, const DeviceImage& image, Lane lane) {
  CORVID_CHECK(image.format == PixelFormat::grey8, "not a grey8 image: use download_float()");
  return download_pixels<std::uint8_t>(device, image, lane);
}

FloatImage download_float(const Device& device, const DeviceImage& image, Lane lane) {
  CORVID_CHECK(image.format == PixelFormat::float32, "not a float32 image: use download()");
  return download_pixels<float>(device, image, lane);
}

PyramidBuilder::PyramidBuilder(std::shared_ptr<Device> device, PixelFormat format, bool gpu,
                               cl::Kernel halve)
    : device_(std::move(device)), format_(format), gpu_(gpu), halve_(std::move(halve)) {}

Expected<PyramidBuilder> PyramidBuilder::create(std::shared_ptr<Device> device,
                                                const std::string& extra_options,
                                                PixelFormat format, KernelKind kind) {
  const std::string options = format_options(format) + extra_options;
  const auto program = build_program(*device, "pyramid", options);
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device, [&] {
    const bool gpu = for_gpu(kind, *device);
    PyramidBuilder builder(device, format, gpu,
                           cl::Kernel(*program, gpu ? "halve_pixels" : "halve_bands"));
    // Drivers compile for a launch shape at its first use: not in front of the first frame.
    (void)builder.build(allocate_image(*device, 64, 48, format), 2);
    return builder;
  });
}

std::shared_ptr<const DevicePyramid> PyramidBuilder::build(const GreyImage& image, int levels,
                                                           Lane lane) {
  CORVID_CHECK(levels >= 1, "a pyramid has at least one level");
  const DeviceImage level = allocate_image(*device_, image.width(), image.height());
  const cl::CommandQueue& queue = device_->queue(lane);
  // The copy waits in the queue, so that there is only one wait, at the end. Nothing may throw
  // past it: the queue would read an image that is gone.
  try {
    on_device("image upload", [&] {
      queue.enqueueWriteBuffer(level.pixels, CL_FALSE, 0, image.size(), image.data());
    });
    return build(level, levels, lane);
  } catch (...) {
    ::clFinish(queue());
    throw;
  }
}

std::shared_ptr<const DevicePyramid> PyramidBuilder::build(const DeviceImage& image, int levels,
                                                           Lane lane) {
  CORVID_CHECK(levels >= 1, "a pyramid has at least one level");
  CORVID_CHECK(image.format == format_, "a pyramid builder is for one format of image");
  constexpr int kMinBand_px = 8192;
  std::vector<DeviceImage> made{image};
  on_device("pyramid", [&] {
    while (static_cast<int>(made.size()) < levels) {
      const DeviceImage in = made.back();
      const int width = (in.width_px + 1) / 2, height = (in.height_px + 1) / 2;
      if (std::min(width, height) < kMinSide_px) break;
      DeviceImage out = allocate_image(*device_, width, height, image.format);
      if (gpu_) {
        set_arguments(halve_, in.pixels, in.width_px, in.height_px, out.pixels, width, height);
        launch_rows(*device_, lane, halve_, width, height);
      } else {
        const int rows = band_rows(*device_, width, height, kMinBand_px);
        set_arguments(halve_, in.pixels, in.width_px, in.height_px, out.pixels, width, height,
                      rows);
        launch_items(*device_, lane, halve_, divide_up(height, rows));
      }
      made.push_back(std::move(out));
    }
    device_->queue(lane).finish();
  });
  return std::make_shared<const DevicePyramid>(std::move(made));
}

}  // namespace corvid
