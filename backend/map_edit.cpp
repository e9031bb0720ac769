#include "backend/map_edit.h"

#include <algorithm>
#include <cmath>

#include "backend/pose_graph.h"
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

/// Positions of a segment's keyframes, ascending.
std::vector<int> keyframes_of(const MapData& map, int segment) {
  std::vector<int> positions;
  for (std::size_t k = 0; k < map.keyframes.size(); ++k)
    if (map.keyframes[k].segment == segment) positions.push_back(static_cast<int>(k));
  return positions;
}

/// Keyframes that share the most landmarks with k, the best `count` of those with at least 15.
std::vector<int> neighbours(const MapData& map, int k, std::size_t count) {
  constexpr int kLeastShared = 15;
  std::map<int, int> shared;
  for (const TrackId id : map.keyframes[static_cast<std::size_t>(k)].tracks) {
    const auto it = map.tracks.find(id);
    if (it == map.tracks.end() || !it->second.landmark) continue;
    for (const KeyframeView& v : it->second.views)
      if (v.keyframe < k) ++shared[v.keyframe];
  }
  std::vector<std::pair<int, int>> order;
  for (const auto& [other, n] : shared)
    if (n >= kLeastShared) order.emplace_back(-n, other);
  std::sort(order.begin(), order.end());
  std::vector<int> best;
  for (std::size_t i = 0; i < std::min(count, order.size()); ++i) best.push_back(order[i].second);
  return best;
}

/// What drifts between two keyframes: the distance by 1 %, the direction and the scale little.
PoseGraphEdge edge(int a, int b, const Sim3& T_a_b) {
  constexpr double kShare = 0.01, kLeast = 1e-4, kRotation_rad = 1e-3, kLogScale = 5e-3;
  return {a,        b, T_a_b, std::max(kLeast, kShare * T_a_b.translation().norm()), kRotation_rad,
          kLogScale};
}

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
                    const std::vector<Sim3>& T_world_keyframe) {
  CORVID_CHECK(T_world_keyframe.size() == map.keyframes.size(), "one similarity per keyframe");
  for (auto& [id, track] : map.tracks) {
    if (!track.landmark || track.views.empty()) continue;
    const auto k = static_cast<std::size_t>(track.views[track.views.size() / 2].keyframe);
    track.p_world =
        T_world_keyframe[k] * (map.keyframes[k].T_world_camera.inverse() * track.p_world);
  }
  for (FrameRecord& record : frames) {
    const double scale = T_world_keyframe[static_cast<std::size_t>(record.keyframe)].scale();
    record.T_keyframe_frame = {record.T_keyframe_frame.rotation(),
                               scale * record.T_keyframe_frame.translation()};
  }
  for (std::size_t k = 0; k < map.keyframes.size(); ++k) {
    MapKeyframe& keyframe = map.keyframes[k];
    const Sim3& S = T_world_keyframe[k];
    if (S.scale() == 1 && S.translation() == keyframe.T_world_camera.translation() &&
        S.rotation().coeffs() == keyframe.T_world_camera.rotation().coeffs())
      continue;
    keyframe.T_world_camera = {S.rotation(), S.translation()};
    Vector7d unit = Vector7d::Ones();
    unit.head<3>() *= S.scale();
    keyframe.drift.covariance = unit.asDiagonal() * keyframe.drift.covariance * unit.asDiagonal();
    keyframe.drift.by_focal = unit.cwiseProduct(keyframe.drift.by_focal);
    keyframe.published = nullptr;
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

bool bend_loop(MapData& map, std::vector<FrameRecord>& frames, int query, int reference,
               const Sim3& T_world_query, int threads) {
  constexpr std::size_t kNeighbours = 6;
  constexpr int kIterations = 20;
  const std::vector<int> nodes = keyframes_of(map, keyframe_at(map, query).segment);
  std::map<int, int> node_of;
  PoseGraph graph;
  for (const int k : nodes) {
    node_of[k] = static_cast<int>(graph.T_world_node.size());
    graph.T_world_node.push_back(as_similarity(keyframe_at(map, k).T_world_camera));
    graph.fixed.push_back(graph.fixed.empty() ? 1 : 0);
  }
  const auto add = [&](int a, int b, const Sim3& T_world_b) {
    graph.edges.push_back(
        edge(node_of[a], node_of[b],
             graph.T_world_node[static_cast<std::size_t>(node_of[a])].inverse() * T_world_b));
  };
  for (std::size_t i = 1; i < nodes.size(); ++i) {
    const Sim3& T = graph.T_world_node[i];
    std::vector<int> others = neighbours(map, nodes[i], kNeighbours);
    std::erase_if(others, [&](int k) { return !node_of.contains(k); });
    for (const int k : others) add(k, nodes[i], T);
    if (std::find(others.begin(), others.end(), nodes[i - 1]) != others.end()) continue;
    // Between them the camera was lost: only so that the graph hangs together.
    constexpr double kLoose = 100;
    add(nodes[i - 1], nodes[i], T);
    PoseGraphEdge& loose = graph.edges.back();
    loose.sigma_translation *= kLoose;
    loose.sigma_rotation_rad *= kLoose;
    loose.sigma_log_scale *= kLoose;
  }
  add(reference, query, T_world_query);
  if (!optimise(graph, kIterations, threads).ok) return false;
  std::vector<Sim3> moved;
  for (const MapKeyframe& k : map.keyframes) moved.push_back(as_similarity(k.T_world_camera));
  for (const int k : nodes)
    moved[static_cast<std::size_t>(k)] = graph.T_world_node[static_cast<std::size_t>(node_of[k])];
  move_keyframes(map, frames, moved);
  return true;
}

}  // namespace corvid
