#pragma once

#include <Eigen/Core>

#include "corvid/map.h"

namespace corvid {

/// The farthest depth in each tile of a depth map: a quick look that tells what the map says
/// nothing of.
class DepthTiles {
 public:
  /// @param tile_px  side of a tile, > 0.
  DepthTiles(const DepthMap& map, int tile_px);

  /// Whether all that the map has around a ball lies more than `margin` in front of it, or the ball
  /// is out of sight. Errs on the side of no.
  /// @param p_camera, radius, margin  [map units], in the map's camera.
  [[nodiscard]] bool hides(const Eigen::Vector3f& p_camera, float radius, float margin) const;

 private:
  float tile_px_;
  float fx_, fy_, cx_, cy_;  ///< the principal point is half a pixel larger, to round by truncation
  FloatImage farthest_;      ///< 0: no answer
};

}  // namespace corvid
