#include "kernels/filter.h"

#include <fmt/core.h>

#include <cmath>
#include <utility>

#include "kernels/launch.h"
#include "kernels/program.h"

namespace corvid {
namespace {

// A work-group's columns and work-items; a CPU's group is one work-item with vectors.
struct Shape {
  int tile_px, members, lanes;
};
constexpr Shape kCpu{1024, 1, 16}, kGpu{128, 128, 1};

// Weights of the window from its centre outwards; both sides sum to 1.
std::vector<float> gaussian_taps(double sigma_px) {
  const int radius = static_cast<int>(std::ceil(4 * sigma_px));
  std::vector<double> weights;
  double sum = 0;
  for (int i = 0; i <= radius; ++i) {
    weights.push_back(std::exp(-i * i / (2 * sigma_px * sigma_px)));
    sum += (i == 0 ? 1 : 2) * weights.back();
  }
  std::vector<float> taps;
  for (const double w : weights) taps.push_back(static_cast<float>(w / sum));
  return taps;
}

}  // namespace

GaussianFilter::GaussianFilter(std::shared_ptr<Device> device, PixelFormat format, bool gpu,
                               cl::Kernel blur, const std::vector<float>& taps)
    : device_(std::move(device)),
      format_(format),
      gpu_(gpu),
      blur_(std::move(blur)),
      taps_(device_) {
  taps_.upload(taps);
}

Expected<GaussianFilter> GaussianFilter::create(std::shared_ptr<Device> device, double sigma_px,
                                                const std::string& extra_options,
                                                PixelFormat format, KernelKind kind) {
  if (!(sigma_px >= kMinSigma_px && sigma_px <= kMaxSigma_px))
    return fail(ErrorCode::invalid_argument, "Gaussian filter of a size that is not supported",
                fmt::format("sigma {} px", sigma_px),
                fmt::format("sigma is {} to {} px", kMinSigma_px, kMaxSigma_px));
  const bool gpu = for_gpu(kind, *device);
  const Shape& shape = gpu ? kGpu : kCpu;
  const auto program = build_program(*device, "filter",
                                     format_options(format) +
                                         fmt::format("-DTILE={} -DMEMBERS={} -DLANES={} ",
                                                     shape.tile_px, shape.members, shape.lanes) +
                                         extra_options);
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device, [&] {
    GaussianFilter filter(device, format, gpu, cl::Kernel(*program, "blur"),
                          gaussian_taps(sigma_px));
    // Drivers compile for a launch shape at its first use: not in front of the first frame.
    (void)filter.filter(allocate_image(*device, 64, 48, format));
    return filter;
  });
}

DeviceImage GaussianFilter::filter(const DeviceImage& image, Lane lane) {
  CORVID_CHECK(image.format == format_, "a filter is for one format of image");
  constexpr int kMinBand_px = 4096, kGpuRows = 8;
  const Shape& shape = gpu_ ? kGpu : kCpu;
  const int width = image.width_px, height = image.height_px;
  const int rows = gpu_ ? kGpuRows : band_rows(*device_, width, height, kMinBand_px);
  DeviceImage out = allocate_image(*device_, width, height, format_);
  on_device("filter", [&] {
    set_arguments(blur_, image.pixels, width, height, out.pixels, taps_.cl(),
                  static_cast<int>(taps_.size()) - 1, rows);
    const auto size = [](int n) { return static_cast<cl::size_type>(n); };
    device_->queue(lane).enqueueNDRangeKernel(
        blur_, cl::NullRange,
        cl::NDRange(size(divide_up(width, shape.tile_px) * shape.members),
                    size(divide_up(height, rows))),
        cl::NDRange(size(shape.members), 1));
    device_->queue(lane).finish();
  });
  return out;
}

}  // namespace corvid
