#pragma once

#include <span>

#include "corvid/error.h"
#include "mapping/cut_views.h"
#include "mapping/surface_cut.h"

namespace corvid {

/// Every option and depth map as cut_surface() wants it.
[[nodiscard]] Expected<void> check_cut(std::span<const SurfaceCutView> views,
                                       const SurfaceCutOptions& options);

/// What to cut into voxels [map units].
struct WantedVolume {
  Eigen::AlignedBox3d box;
  double voxel_size = 0;
};
/// The volume that the options ask for, or that fits the points; 2 voxels or more along each axis.
/// @pre check_cut() went through.
[[nodiscard]] Expected<WantedVolume> choose_volume(std::span<const SurfaceCutView> views,
                                                   const SurfaceCutOptions& options);

/// Whole voxels that cover a box; at most 1e9 along an axis, which no memory holds.
[[nodiscard]] CutVolume volume_of(const Eigen::AlignedBox3d& box, double voxel_size);
[[nodiscard]] Eigen::AlignedBox3d box_of(const CutVolume& volume);

/// That vertices, which are floats, can be told apart so far from the origin.
[[nodiscard]] Expected<void> check_place(const CutVolume& volume);

/// Memory for the arrays that do not depend on the crust.
[[nodiscard]] double dense_bytes(const CutVolume& volume, int threads);

/// That the volume does not fit in memory.
[[nodiscard]] Error too_large(const CutVolume& volume, double bytes, std::size_t max_bytes);
/// That its crust has more places than can be numbered.
[[nodiscard]] Error too_many(const CutVolume& volume, std::size_t places);

}  // namespace corvid
