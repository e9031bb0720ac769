#include "corvid/camera.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <cmath>
#include <numbers>

#include "core/lens.h"

namespace corvid {
namespace {

using Jacobian23 = Eigen::Matrix<double, 2, 3>;
using JacobianK = Eigen::Matrix<double, 2, Camera::kIntrinsics>;

/// Undistorted camera whose corner looks this far off its axis at most: beyond, the centre of a
/// pinhole image of the same size gets too coarse to be of use.
constexpr double kMaxCornerAngle_rad = 70 * std::numbers::pi / 180;

}  // namespace

std::string_view to_string(CameraModel model) {
  switch (model) {
    case CameraModel::pinhole:
      return "pinhole";
    case CameraModel::radtan:
      return "radtan";
    case CameraModel::equidistant:
      return "equidistant";
    case CameraModel::fov:
      return "fov";
  }
  return "unknown";
}

std::string Camera::validate() const {
  std::string problems;
  const auto problem = [&](std::string_view text) {
    if (!problems.empty()) problems += "; ";
    problems += text;
  };
  if (width_px <= 0 || height_px <= 0) {
    problem(fmt::format("the image size must be positive, not {} x {}", width_px, height_px));
  }
  if (!std::isfinite(fx_px) || fx_px <= 0) {
    problem(fmt::format("fx must be positive and finite, not {}", fx_px));
  }
  if (!std::isfinite(fy_px) || fy_px <= 0) {
    problem(fmt::format("fy must be positive and finite, not {}", fy_px));
  }
  if (!std::isfinite(cx_px)) problem("cx must be finite");
  if (!std::isfinite(cy_px)) problem("cy must be finite");
  for (std::size_t i = 0; i < distortion.size(); ++i) {
    if (!std::isfinite(distortion[i])) problem(fmt::format("distortion[{}] must be finite", i));
  }
  if (model == CameraModel::fov && !(distortion[0] >= 0 && distortion[0] < std::numbers::pi)) {
    problem(fmt::format("the fov model's omega must be in [0, pi), not {}", distortion[0]));
  }
  return problems;
}

std::optional<Eigen::Vector2d> Camera::project(const Eigen::Vector3d& p_camera, Jacobian23* d_point,
                                               JacobianK* d_intrinsics) const {
  lens::Projection m;
  if (!lens::project(model, distortion, p_camera, d_intrinsics != nullptr, m)) return std::nullopt;
  const Eigen::Vector2d pixel(fx_px * m.xy.x() + cx_px, fy_px * m.xy.y() + cy_px);
  if (!pixel.allFinite()) return std::nullopt;
  if (d_point) {
    d_point->row(0) = fx_px * m.d_point.row(0);
    d_point->row(1) = fy_px * m.d_point.row(1);
  }
  if (d_intrinsics) {
    d_intrinsics->setZero();
    (*d_intrinsics)(0, 0) = m.xy.x();
    (*d_intrinsics)(1, 1) = m.xy.y();
    (*d_intrinsics)(0, 2) = 1;
    (*d_intrinsics)(1, 3) = 1;
    d_intrinsics->block<1, 5>(0, 4) = fx_px * m.d_distortion.row(0);
    d_intrinsics->block<1, 5>(1, 4) = fy_px * m.d_distortion.row(1);
  }
  return pixel;
}

std::optional<Eigen::Vector3d> Camera::unproject(const Eigen::Vector2d& pixel,
                                                 Eigen::Matrix<double, 3, 2>* d_pixel) const {
  const Eigen::Vector2d m((pixel.x() - cx_px) / fx_px, (pixel.y() - cy_px) / fy_px);
  if (!m.allFinite()) return std::nullopt;
  lens::Ray ray;
  if (!lens::unproject(model, distortion, m, ray)) return std::nullopt;
  if (d_pixel) {
    d_pixel->col(0) = ray.d_xy.col(0) / fx_px;
    d_pixel->col(1) = ray.d_xy.col(1) / fy_px;
  }
  return ray.direction;
}

Eigen::Matrix3d Camera::K() const {
  Eigen::Matrix3d k;
  k << fx_px, 0, cx_px, 0, fy_px, cy_px, 0, 0, 1;
  return k;
}

Camera Camera::undistorted() const {
  Camera out = *this;
  out.model = CameraModel::pinhole;
  out.distortion = {};
  const bool linear = model == CameraModel::pinhole ||
                      (model != CameraModel::equidistant && distortion == out.distortion);
  const Eigen::Vector2d middle((width_px - 1) / 2.0, (height_px - 1) / 2.0);
  const auto axis = unproject(middle);
  if (linear || !axis || axis->z() <= 0) return out;

  // The middle pixel keeps its ray; the focal lengths are scaled by the smallest s with which the
  // whole border of the new image still lies in the old one. Its inside then does as well.
  const auto scaled = [&](double s) {
    Camera c = out;
    c.fx_px = s * fx_px;
    c.fy_px = s * fy_px;
    c.cx_px = middle.x() - c.fx_px * axis->x() / axis->z();
    c.cy_px = middle.y() - c.fy_px * axis->y() / axis->z();
    return c;
  };
  const double max_tangent = std::tan(kMaxCornerAngle_rad);
  const auto fits = [&](const Camera& c) {
    const auto pixel_fits = [&](double u, double v) {
      const Eigen::Vector3d p((u - c.cx_px) / c.fx_px, (v - c.cy_px) / c.fy_px, 1);
      if (p.head<2>().norm() > max_tangent) return false;
      const auto seen = project(p);
      return seen && in_image(*seen);
    };
    for (int x = 0; x < width_px; ++x) {
      if (!pixel_fits(x, 0) || !pixel_fits(x, height_px - 1)) return false;
    }
    for (int y = 0; y < height_px; ++y) {
      if (!pixel_fits(0, y) || !pixel_fits(width_px - 1, y)) return false;
    }
    return true;
  };
  double bad = 0, good = 1;
  for (int i = 0; i < 40 && !fits(scaled(good)); ++i) {
    bad = good;
    good *= 2;
  }
  while (good - bad > 1e-6 * good) {
    const double s = 0.5 * (bad + good);
    (fits(scaled(s)) ? good : bad) = s;
  }
  return scaled(good);
}

}  // namespace corvid
