#include "frontend/epipolar_strip.h"

#include <algorithm>
#include <cmath>

#include "frontend/epipolar.h"

namespace corvid {

std::optional<std::pair<Eigen::Vector2d, Eigen::Vector2d>> clip_line(const Eigen::Vector3d& line,
                                                                     const Camera& camera,
                                                                     double border_px) {
  const double norm = line.head<2>().norm();
  if (!(norm > 1e-300) || !line.allFinite()) return std::nullopt;
  const Eigen::Vector2d normal = line.head<2>() / norm, direction(-normal.y(), normal.x());
  // The undistorted image: a distorting lens sees beyond the pinhole's border.
  Eigen::Vector2d least = Eigen::Vector2d::Zero(), most(camera.width_px - 1, camera.height_px - 1);
  const Eigen::Vector2d middle = 0.5 * most;
  for (double u : {0.0, 0.5, 1.0})
    for (double v : {0.0, 0.5, 1.0})
      if (const auto x =
              undistort_pixel(camera, {u * (camera.width_px - 1), v * (camera.height_px - 1)})) {
        least = least.cwiseMin(*x);
        most = most.cwiseMax(*x);
      }
  least.array() -= border_px;
  most.array() += border_px;
  const Eigen::Vector2d foot = middle - normal * (normal.dot(middle) + line.z() / norm);
  double low = -1e9, high = 1e9;  // along the line, from the foot
  for (int axis = 0; axis < 2; ++axis) {
    if (std::abs(direction[axis]) < 1e-12) {
      if (foot[axis] < least[axis] || foot[axis] > most[axis]) return std::nullopt;
      continue;
    }
    const double a = (least[axis] - foot[axis]) / direction[axis];
    const double b = (most[axis] - foot[axis]) / direction[axis];
    low = std::max(low, std::min(a, b));
    high = std::min(high, std::max(a, b));
  }
  if (!(low < high)) return std::nullopt;
  return std::pair<Eigen::Vector2d, Eigen::Vector2d>{foot + low * direction,
                                                     foot + high * direction};
}

std::vector<SearchWindow> strip_windows(const Camera& camera, const Eigen::Vector2d& from,
                                        const Eigen::Vector2d& to, double half_height_px,
                                        double piece_px) {
  const int pieces =
      static_cast<int>(std::clamp(std::ceil((to - from).norm() / piece_px), 1.0, 1000.0));
  const auto distorted = [&](double share) {
    const Eigen::Vector2d x = from + share * (to - from);
    return camera.project(Eigen::Vector3d((x.x() - camera.cx_px) / camera.fx_px,
                                          (x.y() - camera.cy_px) / camera.fy_px, 1));
  };
  std::vector<SearchWindow> windows;
  auto a = distorted(0);
  for (int i = 0; i < pieces; ++i) {
    const auto b = distorted(static_cast<double>(i + 1) / pieces);
    if (a && b) {
      const SearchWindow window{0.5 * (*a + *b), 0.5 * std::abs(a->x() - b->x()) + half_height_px,
                                0.5 * std::abs(a->y() - b->y()) + half_height_px};
      const double reach_px = std::max(window.radius_x_px, window.radius_y_px);
      if (camera.in_image(window.centre, -reach_px)) windows.push_back(window);
    }
    a = b;
  }
  return windows;
}

}  // namespace corvid
