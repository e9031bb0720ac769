#pragma once

#include <stop_token>
#include <vector>

#include "backend/intrinsics.h"
#include "backend/map_data.h"
#include "corvid/options.h"

namespace corvid {

/// What an adjustment may do beyond poses and points.
struct IntrinsicsPolicy {
  IntrinsicsFreedom freedom = IntrinsicsFreedom::fixed;
  Camera prior;  ///< intrinsics that the source gave
};

/// Adjusts the newest keyframes of the newest segment and the landmarks they see, in place;
/// then drops observations and landmarks that do not fit. A track whose newest observation is
/// dropped is dead. Also estimates the newest keyframe's covariance.
///
/// Older keyframes that see these landmarks are held fixed, not marginalized: measured,
/// docs/decisions/window-past.md.
/// @param first  position of the segment's first keyframe, which is never moved.
/// @param count  keyframes that move.
/// @return whether anything was adjusted.
bool adjust_window(MapData& map, int first, int count, const BackendOptions& options, int threads,
                   const IntrinsicsPolicy& intrinsics);

/// Adjusts every keyframe and landmark of all segments, twice, with outliers dropped in between. A
/// map of more than options.adjustment_views is adjusted in overlapping pieces, so that memory
/// stays bounded; then the intrinsics stay as they are. How far it is goes to the log. Asked to
/// stop, it ends within an iteration, and the map keeps what was reached.
/// @return whether anything was adjusted.
bool adjust_all(MapData& map, const BackendOptions& options, int threads,
                const IntrinsicsPolicy& intrinsics, const std::stop_token& stop);

}  // namespace corvid
