#pragma once

#include <vector>

#include "backend/map_data.h"
#include "backend/place_pose.h"
#include "backend/start.h"

namespace corvid {

/// Two tracks were found to follow one feature: `living` takes the views of `old` and its point,
/// and `old` goes. Refused, with false, if one of them does not exist, if they were seen apart in
/// one keyframe, or if they are the same.
bool fuse_tracks(MapData& map, TrackId living, TrackId old, FusedTracks& fused);

/// One more view of a track, in a keyframe where it was looked for; nothing if it has one there.
void add_view(MapData& map, int keyframe, const TrackObservation& seen);

/// The old landmarks of a recognised place get their views in the query's keyframe; those that one
/// of its own tracks follows to within 0.7 px are fused with that track. Returns how many were.
int connect_place(MapData& map, int query, const PlacePose& place,
                  std::span<const TrackObservation> observations, FusedTracks& fused);

/// Gives tracks without a point, that lie within 12 px of a recognised landmark, a point at its
/// depth: good enough to follow the camera until they are triangulated. Returns how many.
int guess_points(MapData& map, int query, const PlacePose& place,
                 std::span<const TrackObservation> observations, const FusedTracks& fused);

/// Moves keyframes; landmarks follow the keyframe in the middle of their views, frames theirs, and
/// keyframes that rest their hosts.
/// @param T_world_keyframe  one per keyframe of the map: where it shall be, and its own unit of
///                          length; the landmarks it sees are scaled by it.
void move_keyframes(MapData& map, std::vector<FrameRecord>& frames,
                    std::vector<Sim3> T_world_keyframe);

/// Keyframes of segment `from` become part of segment `to`, moved by T_to_from.
/// @param query, at_query  the keyframe of `from` at which they meet, and its drift
///                           in `to`, which all others inherit.
void join_segments(MapData& map, std::vector<FrameRecord>& frames, int from, int to,
                   const Sim3& T_to_from, int query, const Drift& at_query);

}  // namespace corvid
