#include "mapping/ray_grid.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace corvid {
namespace {

/// Rays of the face across `axis` at its lower or upper end.
void add_face(const VoxelGrid& grid, const Eigen::Vector3i& size, int axis, bool upper,
              const Camera& camera, const Pose& T_camera_world, std::vector<GridRay>& rays) {
  const int a = (axis + 1) % 3, b = (axis + 2) % 3;
  Eigen::Vector3i voxel;
  voxel[axis] = upper ? size[axis] - 1 : 0;
  for (voxel[b] = 0; voxel[b] < size[b]; ++voxel[b]) {
    for (voxel[a] = 0; voxel[a] < size[a]; ++voxel[a]) {
      const Eigen::Vector3d centre =
          grid.box.min() + grid.voxel_size * (voxel.cast<double>().array() + 0.5).matrix();
      const auto pixel = camera.project(T_camera_world * centre);
      if (pixel && camera.in_image(*pixel)) rays.push_back({voxel, *pixel});
    }
  }
}

}  // namespace

Eigen::Vector3i VoxelGrid::size() const {
  if (box.isEmpty() || !(voxel_size > 0)) return Eigen::Vector3i::Zero();
  const Eigen::Vector3d count = (box.sizes() / voxel_size).array().ceil();
  if (!count.allFinite() || count.maxCoeff() > std::numeric_limits<int>::max()) {
    return Eigen::Vector3i::Zero();
  }
  return count.cast<int>().cwiseMax(1);
}

std::vector<GridRay> far_side_rays(const VoxelGrid& grid, const Camera& camera,
                                   const Pose& T_world_camera) {
  std::vector<GridRay> rays;
  const Eigen::Vector3i size = grid.size();
  const Eigen::Vector3d s = size.cast<double>();
  constexpr double kMaxFace = 2147483648.0;
  if (size.isZero() || std::max({s.x() * s.y(), s.y() * s.z(), s.z() * s.x()}) > kMaxFace) {
    return rays;
  }
  const Pose T_camera_world = T_world_camera.inverse();
  const Eigen::Vector3d centre = T_world_camera.translation();
  for (int axis = 0; axis < 3; ++axis) {
    const bool below = centre[axis] <= grid.box.min()[axis];
    const bool above = centre[axis] >= grid.box.max()[axis];
    if (!above) add_face(grid, size, axis, true, camera, T_camera_world, rays);
    if (!below) add_face(grid, size, axis, false, camera, T_camera_world, rays);
  }
  return rays;
}

std::optional<DepthInterval> depth_interval(const Eigen::AlignedBox3d& box,
                                            const Pose& T_world_camera) {
  if (box.isEmpty()) return std::nullopt;
  const Pose T_camera_world = T_world_camera.inverse();
  DepthInterval out{std::numeric_limits<double>::infinity(), 0};
  for (int i = 0; i < 8; ++i) {
    const double z =
        (T_camera_world * box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(i))).z();
    if (!std::isfinite(z)) return std::nullopt;
    out.near = std::min(out.near, z);
    out.far = std::max(out.far, z);
  }
  if (!(out.far > 0)) return std::nullopt;
  constexpr double kNearest = 1e-3;
  out.near = std::max(out.near, kNearest * out.far);
  if (!(out.near < out.far)) return std::nullopt;
  return out;
}

int depth_samples(const Camera& camera, const std::vector<Pose>& T_view_reference,
                  const DepthInterval& interval) {
  constexpr int kFewest = 16, kMost = 1024;
  double longest_px = 0;
  const Eigen::Matrix3d K = camera.K(), K_inverse = K.inverse();
  for (const Pose& T : T_view_reference) {
    for (int corner = 0; corner < 5; ++corner) {  // and the middle
      const double x = corner == 4 ? 0.5 : corner % 2, y = corner == 4 ? 0.5 : corner / 2;
      const Eigen::Vector3d ray =
          K_inverse * Eigen::Vector3d(x * camera.width_px, y * camera.height_px, 1);
      const Eigen::Vector3d a = K * (T * (ray * interval.near)), b = K * (T * (ray * interval.far));
      if (!(a.z() > 0 && b.z() > 0)) continue;
      const double px = (a.hnormalized() - b.hnormalized()).norm();
      if (std::isfinite(px)) longest_px = std::max(longest_px, px);
    }
  }
  return static_cast<int>(std::clamp(std::ceil(longest_px), double{kFewest}, double{kMost}));
}

std::vector<float> depths_of(const std::vector<GridRay>& rays, const Camera& camera,
                             const DepthMap& map) {
  std::vector<float> depths;
  depths.reserve(rays.size());
  for (const GridRay& ray : rays) {
    const auto direction = camera.unproject(ray.pixel);
    const auto pixel = direction ? map.camera.project(*direction) : std::nullopt;
    const bool seen = pixel && map.depth.contains(pixel->x(), pixel->y());
    depths.push_back(
        seen ? map.depth(static_cast<int>(pixel->x() + 0.5), static_cast<int>(pixel->y() + 0.5))
             : 0);
  }
  return depths;
}

}  // namespace corvid
