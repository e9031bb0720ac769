#include "backend/map_edit.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/check.h"

namespace corvid {
namespace {

constexpr double kSameFeaturePx = 0.7;
constexpr double kBesidePx = 12;
constexpr double kSeenApartPx = 3;

std::vector<KeyframeView>::iterator view_in(MapTrack& track, int keyframe) {
  return std::lower_bound(track.views.begin(), track.views.end(), keyframe,
                          [](const KeyframeView& v, int k) { return v.keyframe < k; });
}

void insert_track(MapKeyframe& keyframe, TrackId id) {
  const auto at = std::lower_bound(keyframe.tracks.begin(), keyframe.tracks.end(), id);
  if (at == keyframe.tracks.end() || *at != id) keyframe.tracks.insert(at, id);
}

MapKeyframe& keyframe_at(MapData& map, int k) { return map.keyframes[static_cast<std::size_t>(k)]; }

Sim3 as_similarity(const Pose& T) { return {1, T.rotation(), T.translation()}; }

}  // namespace

bool fuse_tracks(MapData& map, TrackId living, TrackId old, FusedTracks& fused) {
  const auto to = map.tracks.find(living), from = map.tracks.find(old);
  if (to == map.tracks.end() || from == map.tracks.end() || to == from) return false;
  if (to->second.dead || !from->second.landmark) return false;
  for (const KeyframeView& v : from->second.views) {
    const auto same = view_in(to->second, v.keyframe);
    if (same != to->second.views.end() && same->keyframe == v.keyframe &&
        (same->pixel - v.pixel).norm() > kSeenApartPx)
      return false;
  }
  MapTrack& track = to->second;
  for (const KeyframeView& v : track.views) keyframe_at(map, v.keyframe).published = nullptr;
  for (const KeyframeView& v : from->second.views) {
    MapKeyframe& keyframe = keyframe_at(map, v.keyframe);
    std::erase(keyframe.tracks, old);
    insert_track(keyframe, living);
    const auto at = view_in(track, v.keyframe);
    if (at != track.views.end() && at->keyframe == v.keyframe) continue;
    track.views.insert(at, v);
    if (keyframe.published) keyframe.renamed.emplace_back(old, living);
  }
  map.stale_landmarks.insert(chunk_of(living));
  track.landmark = true;
  track.p_world = from->second.p_world;
  track.colour = from->second.colour;
  track.max_ray_angle_rad = std::max(track.max_ray_angle_rad, from->second.max_ray_angle_rad);
  track.strikes = track.failures = 0;
  map.erase_track(old);
  fused.erase(living);  // it lives: no chain may lead round in a circle
  fused[old] = living;
  return true;
}

void add_view(MapData& map, int keyframe, const TrackObservation& seen) {
  const auto it = map.tracks.find(seen.track);
  const auto ray = usable_ray(map.camera, seen);
  if (it == map.tracks.end() || !ray) return;
  const auto at = view_in(it->second, keyframe);
  if (at != it->second.views.end() && at->keyframe == keyframe) return;
  it->second.views.insert(at, {keyframe, seen.pixel, *ray, floored_sigma_px(seen)});
  insert_track(keyframe_at(map, keyframe), seen.track);
  keyframe_at(map, keyframe).published = nullptr;
}

int connect_place(MapData& map, int query, const PlacePose& place,
                  std::span<const TrackObservation> observations, FusedTracks& fused) {
  for (const PlaceInlier& inlier : place.inliers) add_view(map, query, inlier.seen);
  int count = 0;
  for (const auto& [i, k] : pair_up(place.inliers, observations, kSameFeaturePx))
    count += fuse_tracks(map, observations[k].track, place.inliers[i].landmark, fused) ? 1 : 0;
  return count;
}

int guess_points(MapData& map, int query, const PlacePose& place,
                 std::span<const TrackObservation> observations, const FusedTracks& fused) {
  const Pose& T_world_query = keyframe_at(map, query).T_world_camera;
  int count = 0;
  for (const TrackObservation& o : observations) {
    const auto track = map.tracks.find(o.track);
    if (track == map.tracks.end() || track->second.landmark || track->second.dead) continue;
    const auto view = view_in(track->second, query);
    if (view == track->second.views.end() || view->keyframe != query) continue;
    const auto nearest = std::min_element(
        place.inliers.begin(), place.inliers.end(), [&](const auto& a, const auto& b) {
          return (a.seen.pixel - o.pixel).squaredNorm() < (b.seen.pixel - o.pixel).squaredNorm();
        });
    if (nearest == place.inliers.end() || (nearest->seen.pixel - o.pixel).norm() > kBesidePx)
      continue;
    const auto beside = map.tracks.find(resolve(fused, nearest->landmark));
    if (beside == map.tracks.end() || !beside->second.landmark) continue;
    const double distance = (beside->second.p_world - T_world_query.translation()).norm();
    Triangulation guess;
    guess.status = TriangulationStatus::ok;
    guess.p_world = T_world_query * (distance * view->ray_camera.normalized());
    map.make_landmark(track->second, guess);
    ++count;
  }
  return count;
}

void move_keyframes(MapData& map, std::vector<FrameRecord>& frames,
                    std::vector<Sim3> T_world_keyframe) {
  CORVID_CHECK(T_world_keyframe.size() == map.keyframes.size(), "one similarity per keyframe");
  for (std::size_t k = 0; k < map.keyframes.size(); ++k) {
    auto& host = map.keyframes[k].host;
    if (!host) continue;
    const Sim3& T_world_host = T_world_keyframe[static_cast<std::size_t>(host->keyframe)];
    T_world_keyframe[k] = T_world_host * as_similarity(host->T_host_this);
    host->T_host_this = {host->T_host_this.rotation(),
                         T_world_host.scale() * host->T_host_this.translation()};
  }
  std::vector<std::optional<Sim3>> T_new_old;  // of keyframes that move
  for (std::size_t k = 0; k < map.keyframes.size(); ++k) {
    const Pose& T = map.keyframes[k].T_world_camera;
    const Sim3& S = T_world_keyframe[k];
    const bool stays = S.scale() == 1 && S.translation() == T.translation() &&
                       S.rotation().coeffs() == T.rotation().coeffs();
    T_new_old.push_back(stays ? std::nullopt : std::optional(S * as_similarity(T).inverse()));
  }
  for (auto& [id, track] : map.tracks) {
    if (!track.landmark || track.views.empty()) continue;
    const auto k = static_cast<std::size_t>(track.views[track.views.size() / 2].keyframe);
    if (!T_new_old[k]) continue;
    track.p_world = *T_new_old[k] * track.p_world;
    map.stale_landmarks.insert(map.stale_landmarks.end(), chunk_of(id));
  }
  for (FrameRecord& record : frames) {
    const double scale = T_world_keyframe[static_cast<std::size_t>(record.keyframe)].scale();
    record.T_keyframe_frame = {record.T_keyframe_frame.rotation(),
                               scale * record.T_keyframe_frame.translation()};
  }
  for (std::size_t k = 0; k < map.keyframes.size(); ++k) {
    if (!T_new_old[k]) continue;
    MapKeyframe& keyframe = map.keyframes[k];
    const Sim3& S = T_world_keyframe[k];
    keyframe.T_world_camera = {S.rotation(), S.translation()};
    Vector7d unit = Vector7d::Ones();
    unit.head<3>() *= S.scale();
    keyframe.drift.covariance = unit.asDiagonal() * keyframe.drift.covariance * unit.asDiagonal();
    keyframe.drift.by_focal = unit.cwiseProduct(keyframe.drift.by_focal);
  }
}

void join_segments(MapData& map, std::vector<FrameRecord>& frames, int from, int to,
                   const Sim3& T_to_from, int query, const Drift& at_query) {
  std::vector<Sim3> moved;
  for (const MapKeyframe& k : map.keyframes)
    moved.push_back(k.segment == from ? T_to_from * as_similarity(k.T_world_camera)
                                      : as_similarity(k.T_world_camera));
  move_keyframes(map, frames, moved);
  const Pose T_world_query = keyframe_at(map, query).T_world_camera;
  for (MapKeyframe& k : map.keyframes) {
    if (k.segment != from) continue;
    k.segment = to;
    const Drift before = at_query.seen_from(T_world_query.inverse() * k.T_world_camera);
    k.drift.covariance += before.covariance;
    k.drift.by_focal += before.by_focal;
  }
}

}  // namespace corvid
