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

GreyImage download(const Device& device, const DeviceImage& image, Lane lane) {
  CORVID_CHECK(image.format == PixelFormat::grey8, "only grey8 images are copied back");
  GreyImage out(image.width_px, image.height_px);
  on_device("image download", [&] {
    device.queue(lane).enqueueReadBuffer(image.pixels, CL_TRUE, 0, out.size(), out.data());
  });
  return out;
}

PyramidBuilder::PyramidBuilder(std::shared_ptr<Device> device, cl::Kernel halve)
    : device_(std::move(device)), halve_(std::move(halve)) {}

Expected<PyramidBuilder> PyramidBuilder::create(std::shared_ptr<Device> device,
                                                const std::string& extra_options) {
  const auto program = build_program(*device, "pyramid", extra_options);
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device, [&] {
    PyramidBuilder builder(device, cl::Kernel(*program, "halve"));
    // Drivers compile for a launch shape at its first use: not in front of the first frame.
    (void)builder.build(GreyImage(64, 48), 2);
    return builder;
  });
}

std::shared_ptr<const DevicePyramid> PyramidBuilder::build(const GreyImage& image, int levels,
                                                           Lane lane) {
  return build(upload(*device_, image, lane), levels, lane);
}

std::shared_ptr<const DevicePyramid> PyramidBuilder::build(const DeviceImage& image, int levels,
                                                           Lane lane) {
  CORVID_CHECK(levels >= 1, "a pyramid has at least one level");
  std::vector<DeviceImage> made{image};
  on_device("pyramid", [&] {
    while (static_cast<int>(made.size()) < levels) {
      const DeviceImage in = made.back();
      const int width = (in.width_px + 1) / 2, height = (in.height_px + 1) / 2;
      if (std::min(width, height) < kMinSide_px) break;
      DeviceImage out = allocate_image(*device_, width, height);
      set_arguments(halve_, in.pixels, in.width_px, in.height_px, out.pixels, width, height);
      launch_rows(*device_, lane, halve_, divide_up(width, 16), height);
      made.push_back(std::move(out));
    }
    device_->queue(lane).finish();
  });
  return std::make_shared<const DevicePyramid>(std::move(made));
}

}  // namespace corvid
