#include "backend/places.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "backend/loop.h"
#include "backend/rest.h"

namespace corvid {
namespace {

constexpr int kLately = 60;    // keyframes
constexpr double kFits = 0.8;  // of the landmarks agree with the pose as it is: no loop to close

/// The query's own tracks in its keyframe.
std::vector<TrackObservation> observations_of(const MapData& map, int keyframe) {
  std::vector<TrackObservation> observations;
  for (const TrackId id : map.keyframes[static_cast<std::size_t>(keyframe)].tracks) {
    const auto it = map.tracks.find(id);
    if (it == map.tracks.end()) continue;
    for (const KeyframeView& v : it->second.views) {
      if (v.keyframe != keyframe) continue;
      TrackObservation o{id, v.pixel, 1, Eigen::Matrix2d::Identity()};
      o.covariance_px2 *= v.sigma_px * v.sigma_px;
      observations.push_back(o);
    }
  }
  return observations;
}

/// Share of the recognised landmarks that agree with a pose.
double fitting(const MapData& map, const PlacePose& place, const Pose& T_world_query,
               double max_error_px) {
  const Pose T_query_world = T_world_query.inverse();
  const auto fits =
      std::count_if(place.inliers.begin(), place.inliers.end(), [&](const PlaceInlier& i) {
        const auto pixel = map.camera.project(T_query_world * map.tracks.at(i.landmark).p_world);
        return pixel && (*pixel - i.seen.pixel).norm() < max_error_px;
      });
  return static_cast<double>(fits) / static_cast<double>(place.inliers.size());
}

/// Whether anything was followed from one keyframe to the other: to one that rests, it was.
bool share_tracks(const MapKeyframe& a, const MapKeyframe& b) {
  if (a.host || b.host) return true;
  return std::any_of(a.tracks.begin(), a.tracks.end(), [&](TrackId id) {
    return std::binary_search(b.tracks.begin(), b.tracks.end(), id);
  });
}

/// Way from one keyframe to another along those of their segment, without the leaps over which
/// nothing was followed: nobody knows how the camera came there, and no drift grew on it.
double way_between(const MapData& map, int a, int b) {
  const int segment = map.keyframes[static_cast<std::size_t>(b)].segment;
  double way = 0;
  const MapKeyframe* last = nullptr;
  for (int k = std::min(a, b); k <= std::max(a, b); ++k) {
    const MapKeyframe& keyframe = map.keyframes[static_cast<std::size_t>(k)];
    if (keyframe.segment != segment) continue;
    if (last && share_tracks(*last, keyframe))
      way += (keyframe.T_world_camera.translation() - last->T_world_camera.translation()).norm();
    last = &keyframe;
  }
  return way;
}

/// Drift of the similarity around the keyframe at which the moved segment hangs, in the other one:
/// that of the keyframe there, carried over, and what the place's pose adds.
Drift drift_of_merge(const MapData& map, int query, const PlacePose& place, double scale,
                     bool query_moves) {
  const MapKeyframe& reference = map.keyframes[static_cast<std::size_t>(place.reference)];
  const Pose T_query_reference = place.T_world_query.inverse() * reference.T_world_camera;
  Vector6d unit = Vector6d::Ones();
  Drift drift;
  if (query_moves) {
    drift = reference.drift.seen_from(T_query_reference.inverse());
  } else {
    unit.head<3>() /= scale;  // the place was found in the units of the part that moves
    drift = map.keyframes[static_cast<std::size_t>(query)].drift;
  }
  drift.covariance.topLeftCorner<6, 6>() +=
      kObservationsPerFact * (unit.asDiagonal() * place.covariance * unit.asDiagonal());
  if (query_moves) return drift;
  return drift.seen_from({T_query_reference.rotation(), T_query_reference.translation() / scale});
}

PlaceOutcome merge(MapData& map, std::vector<FrameRecord>& frames, int query,
                   const PlacePose& place, double scale) {
  PlaceOutcome outcome;
  const MapKeyframe& keyframe = map.keyframes[static_cast<std::size_t>(query)];
  const Pose& T_own = keyframe.T_world_camera;
  const Sim3 T_old_own =
      Sim3(scale, place.T_world_query.rotation(), place.T_world_query.translation()) *
      Sim3(1, T_own.rotation(), T_own.translation()).inverse();
  const bool query_moves = place.segment < keyframe.segment;
  outcome.kind = PlaceOutcome::Kind::merge;
  outcome.from = std::max(place.segment, keyframe.segment);
  outcome.to = std::min(place.segment, keyframe.segment);
  outcome.scale = query_moves ? scale : 1 / scale;
  const int anchor = query_moves ? query : place.reference;
  join_segments(map, frames, outcome.from, outcome.to,
                query_moves ? T_old_own : T_old_own.inverse(), anchor,
                drift_of_merge(map, query, place, scale, query_moves));
  return outcome;
}

}  // namespace

PlaceOutcome recognise_keyframe(MapData& map, std::vector<FrameRecord>& frames, FusedTracks& fused,
                                int query, const PlacePose& place, const BackendOptions& options,
                                int threads) {
  PlaceOutcome outcome;
  const MapKeyframe& keyframe = map.keyframes[static_cast<std::size_t>(query)];
  const Pose T_own = keyframe.T_world_camera;
  const std::vector<TrackObservation> observations = observations_of(map, query);
  const bool same = place.segment == keyframe.segment;
  // Over known ground the window's adjustment takes back what drifted since the last connection:
  // no loop, and no jump, for less than makes a landmark an outlier.
  const bool known = tied_around(map, query, kLately);
  if (same &&
      fitting(map, place, T_own, known ? options.max_error_px : options.huber_px) >= kFits) {
    outcome.kind = PlaceOutcome::Kind::connected;
    connect_place(map, query, place, observations, fused);
    return outcome;
  }
  const double scale = scale_ratio(map, place, T_own, observations);
  if (!(scale > 0)) {
    outcome.reason = "the scale between the two parts of the map cannot be told";
    return outcome;
  }
  if (same) {
    const double moved = (place.T_world_query.translation() - T_own.translation()).norm();
    const double way = way_between(map, place.reference, query);
    if (moved > options.loop_max_drift * way || std::abs(std::log(scale)) > std::log(2.0)) {
      outcome.reason = fmt::format(
          "the loop would move the camera by {:.3g} after a way of {:.3g}, with a scale of {:.3g}",
          moved, way, scale);
      return outcome;
    }
    const Sim3 T_world_query(scale, place.T_world_query.rotation(),
                             place.T_world_query.translation());
    if (!bend_loop(map, frames, query, place.reference, T_world_query, threads)) {
      outcome.reason = "the pose graph cannot be solved";
      return outcome;
    }
    outcome.kind = PlaceOutcome::Kind::loop;
    outcome.scale = scale;
  } else {
    outcome = merge(map, frames, query, place, scale);
  }
  connect_place(map, query, place, observations, fused);
  return outcome;
}

}  // namespace corvid
