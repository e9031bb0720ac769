#pragma once

#include <optional>

#include "backend/map_data.h"

namespace corvid {

/// Keyframes on known ground rest, so that a map grows with the ground that was seen and not with
/// the time in the air (docs/decisions/memory-of-long-flights.md).
///
/// Notes whether keyframe k has 60 landmarks or more in common with a keyframe before `older`: the
/// map is known to fit together there.
void tie(MapData& map, int k, int older);

/// Whether keyframe k or one of its segment within `reach` of it is tied.
[[nodiscard]] bool tied_around(const MapData& map, int k, int reach);

/// The keyframe before `older` that shows what keyframe k shows, from nearly the same place: the
/// median landmark of k lies less than 4 % of the image's width away from where k sees it. Nothing
/// if there is none, if k rests, or if no keyframe of its segment within 10 of it is tied.
[[nodiscard]] std::optional<int> known_view(const MapData& map, int k, int older);

/// Takes what keyframe k saw out of the map; tracks that are left without a view go, those that
/// ended lose their point if fewer than two are left. From then on k moves with `host`.
/// @param alive_from  tracks with a view in this keyframe or a newer one have not ended.
void rest(MapData& map, int k, int host, int alive_from);

/// Puts the keyframes that rest where their hosts have taken them.
void follow_hosts(MapData& map);

}  // namespace corvid
