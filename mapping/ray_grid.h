#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>
#include <vector>

#include "corvid/camera.h"
#include "corvid/image.h"
#include "corvid/map.h"
#include "corvid/pose.h"

namespace corvid {

/// A box cut into cubic voxels; the last ones of a row may stick out.
struct VoxelGrid {
  Eigen::AlignedBox3d box;  ///< [map units, world]
  double voxel_size = 0;    ///< [map units], > 0

  [[nodiscard]] Eigen::Vector3i size() const;  ///< voxels along each axis
};

/// The ray through the centre of a voxel of a far side.
struct GridRay {
  Eigen::Vector3i voxel;
  Eigen::Vector2d pixel;  ///< where the camera sees it
};

/// Rays through the voxels of the volume's far sides (thesis 6.6): along each axis the face that is
/// away from the camera, or both where the camera is between them. Together they pass every voxel
/// that the camera sees. Voxels behind the camera or outside its image have no ray. An empty or
/// inverted box, a voxel size that is not positive or more than 2^31 voxels on a face: no rays.
[[nodiscard]] std::vector<GridRay> far_side_rays(const VoxelGrid& grid, const Camera& camera,
                                                 const Pose& T_world_camera);

/// z in camera coordinates of the volume [map units].
struct DepthInterval {
  double near = 0, far = 0;
};
/// What the volume spans in front of the camera; nothing if no corner of it lies there. `near` is
/// at least a thousandth of `far`.
[[nodiscard]] std::optional<DepthInterval> depth_interval(const Eigen::AlignedBox3d& box,
                                                          const Pose& T_world_camera);

/// Samples, uniform in inverse depth, that move a pixel by about one pixel each in the view where
/// they move it most; between 16 and 1024.
/// @param T_view_reference  of the views compared with, all of the given pinhole.
[[nodiscard]] int depth_samples(const Camera& camera, const std::vector<Pose>& T_view_reference,
                                const DepthInterval& interval);

/// The depth of each ray: that of the pixel that it passes through (thesis 6.4.1), since rays that
/// share a pixel share its correlation. 0: no answer.
/// @param camera  that the rays are of; the map's may be smaller and without its distortion.
[[nodiscard]] std::vector<float> depths_of(const std::vector<GridRay>& rays, const Camera& camera,
                                           const DepthMap& map);

}  // namespace corvid
