#include "frontend/spread_corners.h"

#include <algorithm>
#include <cmath>

namespace corvid {

CornerOptions spread_corners(const DeviceImage& image, int most, int template_px,
                             std::span<const Eigen::Vector2f> occupied) {
  const double area = static_cast<double>(image.width_px) * image.height_px;
  const double spacing_px = std::sqrt(area / most);
  CornerOptions options;
  options.cell_px = std::max(8, static_cast<int>(1.5 * spacing_px));
  options.max_per_cell = 3;
  options.max_count = std::max(0, most - static_cast<int>(occupied.size()));
  options.border_px = template_px / 2 + 2;
  options.occupied = occupied;
  options.min_distance_px = std::max(4.0, 0.5 * spacing_px);
  return options;
}

}  // namespace corvid
