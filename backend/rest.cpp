#include "backend/rest.h"

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "core/check.h"
#include "core/median.h"

namespace corvid {
namespace {

constexpr int kReach = 10;           ///< keyframes
constexpr int kLeastShared = 60;     ///< landmarks
constexpr double kMostMoved = 0.04;  ///< in the image, share of its width

/// Whether k has kLeastShared landmarks in common with a keyframe before `older`.
bool shares_enough(const MapData& map, int k, int older) {
  std::vector<int> shared(static_cast<std::size_t>(older), 0);
  for (const TrackId id : map.keyframes[static_cast<std::size_t>(k)].tracks) {
    const auto it = map.tracks.find(id);
    if (it == map.tracks.end() || !it->second.landmark) continue;
    for (const KeyframeView& v : it->second.views) {
      if (v.keyframe >= older) break;
      if (++shared[static_cast<std::size_t>(v.keyframe)] >= kLeastShared) return true;
    }
  }
  return false;
}

/// Keyframe k's landmarks in its camera.
std::vector<Eigen::Vector3d> points_of(const MapData& map, int k) {
  const MapKeyframe& keyframe = map.keyframes[static_cast<std::size_t>(k)];
  const Pose T_k_world = keyframe.T_world_camera.inverse();
  std::vector<Eigen::Vector3d> points;
  for (const TrackId id : keyframe.tracks) {
    const auto it = map.tracks.find(id);
    if (it != map.tracks.end() && it->second.landmark)
      points.emplace_back(T_k_world * it->second.p_world);
  }
  return points;
}

/// The awake keyframe before `older`, of k's segment, that a point at that depth moves least from.
std::optional<int> nearest(const MapData& map, int k, int older, double depth) {
  const MapKeyframe& keyframe = map.keyframes[static_cast<std::size_t>(k)];
  std::optional<int> best;
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < older; ++i) {
    const MapKeyframe& other = map.keyframes[static_cast<std::size_t>(i)];
    if (other.segment != keyframe.segment || other.host) continue;
    const Pose &a = other.T_world_camera, &b = keyframe.T_world_camera;
    const double angle_rad = (a.translation() - b.translation()).norm() / depth +
                             a.rotation().angularDistance(b.rotation());
    if (angle_rad < least) {
      least = angle_rad;
      best = i;
    }
  }
  return best;
}

/// By how much points lie elsewhere in another image: the median [px].
double moved_px(const Camera& camera, const std::vector<Eigen::Vector3d>& points,
                const Pose& T_other_this) {
  std::vector<double> distances;
  for (const Eigen::Vector3d& p : points) {
    const auto here = camera.project(p), there = camera.project(T_other_this * p);
    if (!here) continue;
    distances.push_back(there ? (*there - *here).norm() : camera.width_px);
  }
  return distances.empty() ? camera.width_px : upper_median(std::move(distances));
}

}  // namespace

void tie(MapData& map, int k, int older) {
  if (older > 0) map.keyframes[static_cast<std::size_t>(k)].tied = shares_enough(map, k, older);
}

bool tied_around(const MapData& map, int k, int reach) {
  const int last = static_cast<int>(map.keyframes.size()) - 1;
  for (int i = std::max(0, k - reach); i <= std::min(last, k + reach); ++i) {
    const MapKeyframe& near = map.keyframes[static_cast<std::size_t>(i)];
    if (near.tied && near.segment == map.keyframes[static_cast<std::size_t>(k)].segment)
      return true;
  }
  return false;
}

std::optional<int> known_view(const MapData& map, int k, int older) {
  const MapKeyframe& keyframe = map.keyframes[static_cast<std::size_t>(k)];
  if (keyframe.host || !tied_around(map, k, kReach)) return std::nullopt;
  const std::vector<Eigen::Vector3d> points = points_of(map, k);
  if (points.empty()) return std::nullopt;
  std::vector<double> depths;
  for (const Eigen::Vector3d& p : points) depths.push_back(p.norm());
  const auto other = nearest(map, k, older, upper_median(std::move(depths)));
  if (!other) return std::nullopt;
  const Pose T_other_this =
      map.keyframes[static_cast<std::size_t>(*other)].T_world_camera.inverse() *
      keyframe.T_world_camera;
  if (moved_px(map.camera, points, T_other_this) >= kMostMoved * map.camera.width_px)
    return std::nullopt;
  return other;
}

void rest(MapData& map, int k, int host, int alive_from) {
  MapKeyframe& keyframe = map.keyframes[static_cast<std::size_t>(k)];
  const MapKeyframe& at = map.keyframes[static_cast<std::size_t>(host)];
  CORVID_CHECK(!keyframe.host && !at.host && host != k, "a host is awake");
  keyframe.host = {host, at.T_world_camera.inverse() * keyframe.T_world_camera};
  keyframe.published = nullptr;
  for (const TrackId id : std::exchange(keyframe.tracks, {})) {
    const auto it = map.tracks.find(id);
    if (it == map.tracks.end()) continue;
    MapTrack& track = it->second;
    map.stale_landmarks.insert(chunk_of(id));
    std::erase_if(track.views, [k](const KeyframeView& v) { return v.keyframe == k; });
    if (!track.views.empty() && track.views.back().keyframe >= alive_from) continue;
    if (track.views.size() >= 2) continue;
    for (const KeyframeView& v : track.views) {
      MapKeyframe& other = map.keyframes[static_cast<std::size_t>(v.keyframe)];
      std::erase(other.tracks, id);
      other.published = nullptr;
    }
    map.erase_track(id);
  }
}

void follow_hosts(MapData& map) {
  for (MapKeyframe& keyframe : map.keyframes) {
    if (!keyframe.host) continue;
    const MapKeyframe& host = map.keyframes[static_cast<std::size_t>(keyframe.host->keyframe)];
    keyframe.T_world_camera = host.T_world_camera * keyframe.host->T_host_this;
  }
}

}  // namespace corvid
