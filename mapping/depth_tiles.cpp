#include "mapping/depth_tiles.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace corvid {

DepthTiles::DepthTiles(const DepthMap& map, int tile_px)
    : tile_px_(static_cast<float>(tile_px)),
      fx_(static_cast<float>(map.camera.fx_px)),
      fy_(static_cast<float>(map.camera.fy_px)),
      cx_(static_cast<float>(map.camera.cx_px + 0.5)),
      cy_(static_cast<float>(map.camera.cy_px + 0.5)),
      farthest_((map.depth.width() + tile_px - 1) / tile_px,
                (map.depth.height() + tile_px - 1) / tile_px) {
  for (int y = 0; y < map.depth.height(); ++y) {
    for (int x = 0; x < map.depth.width(); ++x) {
      float& far = farthest_(x / tile_px, y / tile_px);
      far = std::max(far, map.depth(x, y));
    }
  }
}

bool DepthTiles::hides(const Eigen::Vector3f& p_camera, float radius, float margin) const {
  if (p_camera.z() < -radius) return true;
  if (p_camera.z() < 2 * radius) return false;
  // A ball's image reaches at most |offset| / (z - r) farther than its centre's.
  const float reach = radius / (p_camera.z() - radius);
  const auto range = [&](float f, float c, float x, int tiles) {
    const float middle = f * x / p_camera.z() + c;
    const float wide = (f + std::abs(middle - c)) * reach + 1;
    const auto tile = [&](float at) {
      return static_cast<int>(
          std::floor(std::clamp(at / tile_px_, -1.F, static_cast<float>(tiles))));
    };
    return std::array{std::max(tile(middle - wide), 0), std::min(tile(middle + wide), tiles - 1)};
  };
  const auto [left, right] = range(fx_, cx_, p_camera.x(), farthest_.width());
  const auto [top, bottom] = range(fy_, cy_, p_camera.y(), farthest_.height());
  for (int y = top; y <= bottom; ++y) {
    for (int x = left; x <= right; ++x) {
      if (farthest_(x, y) > 0 && farthest_(x, y) > p_camera.z() - radius - margin) return false;
    }
  }
  return true;
}

}  // namespace corvid
