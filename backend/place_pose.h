#pragma once

#include <map>
#include <span>
#include <string>
#include <vector>

#include "backend/map_data.h"
#include "core/place.h"
#include "corvid/options.h"

namespace corvid {

/// An old landmark in the query that agrees with the query's pose.
struct PlaceInlier {
  TrackId landmark;
  TrackObservation seen;  ///< pixel and covariance in the query; `track` is the landmark
};

/// Where a frame lies in a part of the map that it was recognised in.
struct PlacePose {
  bool ok = false;
  std::string refusal;  ///< why not, for the log
  int segment = 0;
  int reference = 0;  ///< position of the keyframe that has most in common with it
  Pose T_world_query;
  Matrix6d covariance = Matrix6d::Zero();  ///< right perturbation, landmarks taken as exact
  std::vector<PlaceInlier> inliers;        ///< ascending by landmark
};

/// Tracks that were taken for the same feature: old id to new id, in chains.
using FusedTracks = std::map<TrackId, TrackId>;
[[nodiscard]] TrackId resolve(const FusedTracks& fused, TrackId id);

/// Pose of the query from the landmarks of the references' segment, by P3P and refinement.
///
/// A false place is worse than a missed one. Refused: fewer than 30 inliers, less than half of the
/// views, inliers in fewer than 5 of 4 x 4 parts of the image, and an ambiguous place: another
/// reference gives another pose of its own (repeated facades).
[[nodiscard]] PlacePose place_pose(const MapData& map, const FusedTracks& fused,
                                   const PlaceMatch& match, const BackendOptions& options);

/// How many units of the old map one unit of the query's own map is: the median ratio of the depths
/// of an old landmark and a landmark of the query's own tracks beside it. 0 if fewer than 10 pairs
/// agree within 20 %.
/// @param T_own_query  pose of the query in its own map; `observations` are its tracks there.
[[nodiscard]] double scale_ratio(const MapData& map, const PlacePose& place,
                                 const Pose& T_own_query,
                                 std::span<const TrackObservation> observations);

/// For each inlier, the track of the query nearest to it and within `distance_px`: pairs of
/// positions (inlier, observation). No observation comes twice.
[[nodiscard]] std::vector<std::pair<std::size_t, std::size_t>> pair_up(
    std::span<const PlaceInlier> inliers, std::span<const TrackObservation> observations,
    double distance_px);

}  // namespace corvid
