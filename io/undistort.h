#pragma once

#include <Eigen/Core>
#include <optional>

#include "corvid/camera.h"
#include "corvid/image.h"

namespace corvid {

/// Turns images of one camera into those of its undistorted pinhole (Camera::undistorted()), on
/// the CPU; for exports, not for tracking. Immutable after construction.
class Undistorter {
 public:
  explicit Undistorter(const Camera& camera);

  /// The pinhole of the undistorted images.
  [[nodiscard]] const Camera& camera() const { return to_; }
  /// Bicubic; black where the camera did not look. The image must have the camera's size
  /// (CORVID_CHECK).
  [[nodiscard]] GreyImage operator()(const GreyImage& image) const;
  [[nodiscard]] ColourImage operator()(const ColourImage& image) const;
  /// Where a pixel of the camera's own image lies in the undistorted one, or nothing where the
  /// model has no answer. May lie outside the image.
  [[nodiscard]] std::optional<Eigen::Vector2d> pixel(const Eigen::Vector2d& distorted) const;

 private:
  Camera from_, to_;
  bool identity_ = false;
  FloatImage map_x_, map_y_;  ///< source pixel of each undistorted pixel
};

}  // namespace corvid
