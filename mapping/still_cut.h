#pragma once

#include <span>

#include "mapping/still_depth.h"
#include "mapping/surface_cut.h"

namespace corvid {

/// The minimal surface through the depths of stills on which at least `min_views` views agree,
/// with the photographs' colours. Errors: those of cut_surface().
/// @param depths  of depth_of_stills(views), so of one camera.
[[nodiscard]] Expected<SurfaceCut> cut_stills(std::span<const StillView> views,
                                              std::span<const StillDepth> depths,
                                              const SurfaceCutOptions& options,
                                              const SurfaceCutControl& control = {},
                                              int min_views = 2);

}  // namespace corvid
