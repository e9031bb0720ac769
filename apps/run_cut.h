#pragma once

#include <stop_token>

#include "corvid/run_result.h"
#include "mapping/surface_cut.h"

namespace corvid {

/// The minimal surface of a run's depth maps (mapping/surface_cut.h), in the frame and unit of the
/// result, with the options mapping.cut_*; voxels as large as the live map's unless these say
/// otherwise. Of the map segment with the most depth maps, since segments have no common frame.
/// Tells the log what it does.
/// Errors: as cut_surface(); not_found if the run has no depth map or no voxel is
/// inside.
[[nodiscard]] Expected<SurfaceCut> cut_run(const RunResult& result, const std::stop_token& stop);

}  // namespace corvid
