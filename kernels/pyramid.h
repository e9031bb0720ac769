#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/check.h"
#include "corvid/image.h"
#include "kernels/device.h"

namespace corvid {

enum class PixelFormat { grey8, float32 };

/// An image on the device, row-major, pitch = width. Made by allocate_image(): kernels read whole
/// vectors, up to kImagePadding bytes past the last row. Its pixels do not change once it was
/// filled: what is derived from it may be kept under its id.
struct DeviceImage {
  static constexpr int kImagePadding = 512;
  cl::Buffer pixels;
  int width_px = 0, height_px = 0;
  PixelFormat format = PixelFormat::grey8;
  std::uint64_t id = 0;  ///< unique in the process; copies of this handle share it
};

/// An image of undefined content. Throws DeviceFault.
[[nodiscard]] DeviceImage allocate_image(const Device& device, int width_px, int height_px,
                                         PixelFormat format = PixelFormat::grey8);
/// Copies to the device; done on return. Throws DeviceFault.
[[nodiscard]] DeviceImage upload(const Device& device, const GreyImage& image,
                                 Lane lane = Lane::tracking);
[[nodiscard]] DeviceImage upload(const Device& device, const FloatImage& image,
                                 Lane lane = Lane::tracking);
/// Waits for the lane and copies a grey8 image back. Throws DeviceFault.
[[nodiscard]] GreyImage download(const Device& device, const DeviceImage& image,
                                 Lane lane = Lane::tracking);
/// The same for a float32 image.
[[nodiscard]] FloatImage download_float(const Device& device, const DeviceImage& image,
                                        Lane lane = Lane::tracking);

/// Level 0 is the image itself; level i + 1 has half the size of level i (odd sizes round up).
/// A point of the image at x_px (level 0) lies at x_px / 2^i in level i, exactly. Immutable.
class DevicePyramid {
 public:
  explicit DevicePyramid(std::vector<DeviceImage> levels) : levels_(std::move(levels)) {}
  [[nodiscard]] int levels() const { return static_cast<int>(levels_.size()); }
  [[nodiscard]] const DeviceImage& level(int i) const {
    CORVID_CHECK(i >= 0 && i < levels(), "no such pyramid level");
    return levels_[static_cast<std::size_t>(i)];
  }

 private:
  std::vector<DeviceImage> levels_;
};

/// Where one source cannot serve both kinds of device, a launcher has kernels for each; they give
/// the same answers. `suited` is what anyone but a test wants.
enum class KernelKind { suited, cpu, gpu };

/// Whether the kernels for GPUs are meant.
[[nodiscard]] inline bool for_gpu(KernelKind kind, const Device& device) {
  return kind == KernelKind::suited ? device.info().gpu : kind == KernelKind::gpu;
}

/// The compiler option for kernels that serve both formats.
[[nodiscard]] inline std::string format_options(PixelFormat format) {
  return format == PixelFormat::float32 ? "-DFLOAT_IMAGE " : "";
}

/// Builds pyramids: 5-tap binomial filter [1 4 6 4 1]/16 in both directions, border pixels
/// repeated, every other pixel kept (Burt and Adelson, "The Laplacian pyramid as a compact image
/// code", 1983); levels of grey8 images are rounded to nearest. One format of image per builder.
/// One owner; build() may be called from one thread at a time.
class PyramidBuilder {
 public:
  static constexpr int kMinSide_px = 16;  ///< no level is made with a side shorter than this

  /// @param extra_options  compiler options, for tests.
  [[nodiscard]] static Expected<PyramidBuilder> create(std::shared_ptr<Device> device,
                                                       const std::string& extra_options = {},
                                                       PixelFormat format = PixelFormat::grey8,
                                                       KernelKind kind = KernelKind::suited);

  /// @param levels  >= 1; fewer are made if a level would become smaller than kMinSide_px.
  /// Done on return, so the pyramid may be used in any lane. Throws DeviceFault.
  [[nodiscard]] std::shared_ptr<const DevicePyramid> build(const GreyImage& image, int levels,
                                                           Lane lane = Lane::tracking);
  /// The same from an image that is on the device already; it becomes level 0 without a copy.
  /// @pre  the builder's format.
  [[nodiscard]] std::shared_ptr<const DevicePyramid> build(const DeviceImage& image, int levels,
                                                           Lane lane = Lane::tracking);

 private:
  PyramidBuilder(std::shared_ptr<Device> device, PixelFormat format, bool gpu, cl::Kernel halve);

  std::shared_ptr<Device> device_;
  PixelFormat format_;
  bool gpu_;
  cl::Kernel halve_;
};

}  // namespace corvid
