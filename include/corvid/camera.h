#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "corvid/error.h"

namespace corvid {

/// Lens models. Parameters in `Camera::distortion`:
/// pinhole: none. radtan (Brown-Conrady, OpenCV order): k1 k2 p1 p2 k3.
/// equidistant (Kannala-Brandt, OpenCV fisheye): k1 k2 k3 k4. fov (Devernay-Faugeras): omega [rad].
enum class CameraModel { pinhole, radtan, equidistant, fov };
[[nodiscard]] std::string_view to_string(CameraModel model);

/// A central camera: rays in camera coordinates (x right, y down, z forward) to pixels.
/// Pixel (0,0) is the centre of the top-left pixel.
struct Camera {
  static constexpr int kIntrinsics = 9;  ///< fx fy cx cy and up to 5 distortion values

  CameraModel model = CameraModel::pinhole;
  int width_px = 0, height_px = 0;
  double fx_px = 0, fy_px = 0, cx_px = 0, cy_px = 0;
  std::array<double, 5> distortion{};

  /// Lists every problem (sizes, non-finite or non-positive focal lengths), empty if none.
  [[nodiscard]] std::string validate() const;

  /// Pixel of a point in camera coordinates, or nothing where the model does not hold: behind the
  /// camera for pinhole and radtan (z <= 0), beyond the radius where the distortion stops being
  /// monotonic, beyond 180 degrees for the fisheye models. The pixel may lie outside the image.
  /// @param d_point  if not null, 2x3 Jacobian of the pixel by the point.
  /// @param d_intrinsics  if not null, 2x9 Jacobian by (fx fy cx cy distortion[0..4]).
  [[nodiscard]] std::optional<Eigen::Vector2d> project(
      const Eigen::Vector3d& p_camera, Eigen::Matrix<double, 2, 3>* d_point = nullptr,
      Eigen::Matrix<double, 2, kIntrinsics>* d_intrinsics = nullptr) const;

  /// Unit ray through a pixel, or nothing where the model cannot be inverted.
  /// @param d_pixel  if not null, 3x2 Jacobian of the unit ray by the pixel.
  [[nodiscard]] std::optional<Eigen::Vector3d> unproject(
      const Eigen::Vector2d& pixel, Eigen::Matrix<double, 3, 2>* d_pixel = nullptr) const;

  /// K of the linear part.
  [[nodiscard]] Eigen::Matrix3d K() const;
  [[nodiscard]] bool in_image(const Eigen::Vector2d& pixel, double border_px = 0) const {
    return pixel.x() >= border_px && pixel.y() >= border_px &&
           pixel.x() <= width_px - 1 - border_px && pixel.y() <= height_px - 1 - border_px;
  }
  /// An undistorted pinhole of the same size whose view lies inside this one's: what a rectified
  /// image of this camera has. Same K where there is no distortion.
  [[nodiscard]] Camera undistorted() const;
  bool operator==(const Camera&) const = default;
};

}  // namespace corvid
