#include "core/place.h"

#include <algorithm>
#include <bitset>

namespace corvid {

int parts_seen(const Camera& camera, std::span<const Eigen::Vector2d> pixels) {
  constexpr int kSide = 4;
  std::bitset<static_cast<std::size_t>(kSide * kSide)> parts;
  const auto part = [](double x, int size) {
    return static_cast<int>(std::clamp(kSide * (x + 0.5) / size, 0.0, kSide - 0.5));
  };
  for (const Eigen::Vector2d& x : pixels) {
    if (!x.allFinite()) continue;
    parts.set(static_cast<std::size_t>(part(x.y(), camera.height_px) * kSide +
                                       part(x.x(), camera.width_px)));
  }
  return static_cast<int>(parts.count());
}

}  // namespace corvid
