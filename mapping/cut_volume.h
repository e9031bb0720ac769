#pragma once

#include <span>

#include "corvid/error.h"
#include "mapping/cut_views.h"
#include "mapping/surface_cut.h"

namespace corvid {

/// Every option and depth map as cut_surface() wants it.
[[nodiscard]] Expected<void> check_cut(std::span<const SurfaceCutView> views,
                                       const SurfaceCutOptions& options);

/// The volume that the options ask for, or that fits the points.
/// @pre check_cut() went through.
[[nodiscard]] Expected<CutVolume> choose_volume(std::span<const SurfaceCutView> views,
                                                const SurfaceCutOptions& options);

[[nodiscard]] Eigen::AlignedBox3d box_of(const CutVolume& volume);

/// The same volume in voxels that are larger by `factor`.
[[nodiscard]] CutVolume coarser(const CutVolume& volume, double factor);

/// Memory for the arrays that do not depend on the crust.
[[nodiscard]] double dense_bytes(const CutVolume& volume, int threads);

/// That the volume does not fit in memory.
[[nodiscard]] Error too_large(const CutVolume& volume, double bytes, std::size_t max_bytes);

}  // namespace corvid
