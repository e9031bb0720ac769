#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>

#include "corvid/camera.h"
#include "corvid/frame.h"
#include "corvid/image.h"
#include "kernels/pyramid.h"

namespace corvid {

/// For each pixel of a warped image, where it is read in the source image [px]. Made once per
/// camera pair or homography and kept by the caller. Immutable.
class WarpMap {
 public:
  /// Marks pixels that see nothing of the source.
  static constexpr float kOutside = -1e6F;
  struct Point {
    float x_px = kOutside, y_px = kOutside;
    bool operator==(const Point&) const = default;
  };

  /// The picture that camera `to` would take from the place of camera `from`: undistortion,
  /// rectification, rotation. x_from = project_from(R_from_to * unproject_to(x_to)).
  /// The size is that of `to`.
  [[nodiscard]] static WarpMap between(const Camera& from, const Camera& to,
                                       const Eigen::Matrix3d& R_from_to);
  /// x_source ~ H * x_warped; points with a third coordinate <= 0 are outside.
  [[nodiscard]] static WarpMap homography(const Eigen::Matrix3d& H_source_warped, int width_px,
                                          int height_px);

  [[nodiscard]] int width() const { return points_.width(); }
  [[nodiscard]] int height() const { return points_.height(); }
  [[nodiscard]] const Image<Point>& points() const { return points_; }
  /// 255 where all four pixels of the bilinear sample lie in a source of this size, else 0.
  [[nodiscard]] GreyImage valid(int source_width_px, int source_height_px) const;

 private:
  explicit WarpMap(Image<Point> points) : points_(std::move(points)) {}
  Image<Point> points_;
};

/// Bilinear warp on the host; 0 (black) outside.
[[nodiscard]] GreyImage remap(const GreyImage& source, const WarpMap& map);
[[nodiscard]] FloatImage remap(const FloatImage& source, const WarpMap& map);
[[nodiscard]] ColourImage remap(const ColourImage& source, const WarpMap& map);
/// The frame's colours, or its grey values as colours, through a map from its lens; empty if the
/// frame has neither of the lens's size.
[[nodiscard]] ColourImage remap_colours(const Frame& frame, const Camera& lens, const WarpMap& map);

/// A WarpMap on the device.
struct DeviceWarpMap {
  cl::Buffer points;
  int width_px = 0, height_px = 0;
};

/// The homography that WarpMap::between() is where both cameras are pinholes (rectified images):
/// x_from ~ K_from R_from_to K_to^-1 x_to.
/// @pre  both cameras are pinholes.
[[nodiscard]] Eigen::Matrix3d homography_between(const Camera& from, const Camera& to,
                                                 const Eigen::Matrix3d& R_from_to);

/// Bilinear warp on the device, 0 outside; grey8 images are rounded to nearest. One format of image
/// per warper. One owner; one thread at a time. Throws DeviceFault.
class Warper {
 public:
  /// @param extra_options  compiler options, for tests.
  [[nodiscard]] static Expected<Warper> create(std::shared_ptr<Device> device,
                                               const std::string& extra_options = {},
                                               PixelFormat format = PixelFormat::grey8,
                                               KernelKind kind = KernelKind::suited);
  [[nodiscard]] DeviceWarpMap upload(const WarpMap& map, Lane lane = Lane::tracking);
  /// Done on return, so the image may be used in any lane.
  [[nodiscard]] DeviceImage remap(const DeviceImage& source, const DeviceWarpMap& map,
                                  Lane lane = Lane::tracking);
  /// remap() by WarpMap::homography(H_source_warped, width_px, height_px), but the places are
  /// computed on the device, so nothing but the matrix is sent. Done on return.
  [[nodiscard]] DeviceImage warp(const DeviceImage& source, const Eigen::Matrix3d& H_source_warped,
                                 int width_px, int height_px, Lane lane = Lane::tracking);

 private:
  Warper(std::shared_ptr<Device> device, PixelFormat format, bool gpu, const cl::Program& program);
  // Runs the kernel with what is common to both, then `places`.
  template <class... Places>
  DeviceImage run(cl::Kernel& kernel, const DeviceImage& source, int width_px, int height_px,
                  Lane lane, const Places&... places);

  std::shared_ptr<Device> device_;
  PixelFormat format_;
  bool gpu_;
  cl::Kernel remap_, homography_;
};

}  // namespace corvid
