#include "frontend/disambiguate/weak_corners.h"

namespace corvid {

bool has_corner_score(const Eigen::Vector2f& point, int width_px, int height_px) {
  constexpr float kReachPx = 4;  // of corners.cl
  const auto inside = [](float x, int size) {
    return x > kReachPx - 0.5F && x < static_cast<float>(size) - kReachPx - 0.5F;
  };
  return inside(point.x(), width_px) && inside(point.y(), height_px);
}

bool is_weak_corner(float score_r, float score_t, const Eigen::Vector2f& point, int width_px,
                    int height_px, double ratio) {
  return has_corner_score(point, width_px, height_px) && score_r > ratio * score_t;
}

}  // namespace corvid
