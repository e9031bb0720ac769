#pragma once

#include <span>
#include <string>
#include <vector>

#include "backend/map_data.h"
#include "backend/map_edit.h"
#include "backend/place_pose.h"
#include "backend/start.h"
#include "corvid/options.h"

namespace corvid {

/// What recognising a keyframe of the map did.
struct PlaceOutcome {
  enum class Kind {
    refused,
    connected,  ///< the map fits already: its parts are only tied together
    loop,       ///< keyframes moved
    merge,      ///< two segments became one, and the newer one moved
  } kind = Kind::refused;
  std::string reason;    ///< why it was refused
  int from = 0, to = 0;  ///< of a merge: segment `from` is now part of `to`
  double scale = 1;      ///< what a length around the query was multiplied with
};

/// A keyframe of the map was recognised: ties it to the old keyframes of the same segment, closes
/// the loop if the map does not fit there, or joins the two segments. The landmarks around are
/// connected, so that the next window adjustments keep the parts together.
///
/// Refused, without any change: places that place_pose() refuses (which made `place`), a scale that
/// cannot be told between segments, and loops that move the camera farther than drift explains:
/// options.loop_max_drift of the way flown since, or more than a factor of two in scale.
[[nodiscard]] PlaceOutcome recognise_keyframe(MapData& map, std::vector<FrameRecord>& frames,
                                              FusedTracks& fused, int query, const PlacePose& place,
                                              const BackendOptions& options, int threads);

}  // namespace corvid
