#pragma once

#include <memory>
#include <string>
#include <vector>

#include "kernels/buffer.h"
#include "kernels/pyramid.h"

namespace corvid {

/// Gaussian filter on the device: separable, window of 2 ceil(4 sigma) + 1 pixels whose weights sum
/// to 1 in each direction, border pixels repeated; grey8 images are rounded to nearest.
/// One owner; one thread at a time. Methods throw DeviceFault.
class GaussianFilter {
 public:
  static constexpr double kMinSigma_px = 0.3, kMaxSigma_px = 10;

  /// Fails (invalid_argument) if sigma_px is not in [kMinSigma_px, kMaxSigma_px], or if the kernel
  /// does not build.
  /// @param format  of the images; others are refused.
  /// @param extra_options  compiler options, for tests.
  [[nodiscard]] static Expected<GaussianFilter> create(std::shared_ptr<Device> device,
                                                       double sigma_px,
                                                       const std::string& extra_options = {},
                                                       PixelFormat format = PixelFormat::grey8,
                                                       KernelKind kind = KernelKind::suited);

  /// An image of the same size and format. Done on return, so it may be used in any lane.
  [[nodiscard]] DeviceImage filter(const DeviceImage& image, Lane lane = Lane::tracking);

 private:
  GaussianFilter(std::shared_ptr<Device> device, PixelFormat format, bool gpu, cl::Kernel blur,
                 const std::vector<float>& taps);

  std::shared_ptr<Device> device_;
  PixelFormat format_;
  bool gpu_;
  cl::Kernel blur_;
  Buffer<float> taps_;
};

}  // namespace corvid
