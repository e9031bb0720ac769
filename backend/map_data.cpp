#include "backend/map_data.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"

namespace corvid {
namespace {

Rgb8 colour_at(const Frame& frame, const Eigen::Vector2d& pixel) {
  const int x = static_cast<int>(std::lround(pixel.x()));
  const int y = static_cast<int>(std::lround(pixel.y()));
  if (frame.colour.contains(x, y)) return frame.colour(x, y);
  if (frame.grey.contains(x, y)) {
    const std::uint8_t g = frame.grey(x, y);
    return {g, g, g};
  }
  return {};
}

constexpr int kChunkBits = 7;  ///< of a landmark's id, below its chunk

/// Makes the chunks that are stale anew.
void publish_landmarks(MapData& map) {
  for (const std::uint32_t key : std::exchange(map.stale_landmarks, {})) {
    std::vector<Landmark> landmarks;
    const auto end =
        map.tracks.upper_bound(TrackId((key << kChunkBits) | ((1U << kChunkBits) - 1)));
    for (auto it = map.tracks.lower_bound(TrackId(key << kChunkBits)); it != end; ++it) {
      const MapTrack& track = it->second;
      if (!track.landmark) continue;
      landmarks.push_back({LandmarkId(it->first.value), track.p_world, track.colour,
                           static_cast<int>(track.views.size()), track.max_ray_angle_rad});
    }
    if (landmarks.empty()) {
      map.published_landmarks.erase(key);
    } else {
      map.published_landmarks[key] = std::make_shared<const std::vector<Landmark>>(landmarks);
    }
  }
}

/// Where a keyframe is, or to what it belongs, is not what was published.
bool moved(const MapKeyframe& keyframe) {
  const Pose &now = keyframe.T_world_camera, &then = keyframe.published->T_world_camera;
  return keyframe.segment != keyframe.published->segment ||
         now.translation() != then.translation() ||
         now.rotation().coeffs() != then.rotation().coeffs();
}

/// The keyframe at its new place: it sees what it saw.
std::shared_ptr<const Keyframe> replaced(const MapKeyframe& keyframe) {
  auto copy = std::make_shared<Keyframe>(*keyframe.published);
  copy->segment = keyframe.segment;
  copy->T_world_camera = keyframe.T_world_camera;
  return copy;
}

/// The keyframe with landmarks under their new ids; null if it does not see one of them.
std::shared_ptr<const Keyframe> renamed(const MapKeyframe& keyframe) {
  auto copy = std::make_shared<Keyframe>(*keyframe.published);
  for (const auto& [from, to] : keyframe.renamed) {
    const auto it = std::find_if(
        copy->observations.begin(), copy->observations.end(),
        [id = LandmarkId(from.value)](const Observation& o) { return o.landmark == id; });
    if (it == copy->observations.end()) return nullptr;
    it->landmark = LandmarkId(to.value);
  }
  std::sort(copy->observations.begin(), copy->observations.end(),
            [](const Observation& a, const Observation& b) { return a.landmark < b.landmark; });
  return copy;
}

}  // namespace

std::uint32_t chunk_of(TrackId id) { return id.value >> kChunkBits; }

double floored_sigma_px(const TrackObservation& observation) {
  constexpr double kFloorPx = 0.3, kDefaultPx = 1;
  const double sigma = largest_sigma_px(observation.covariance_px2);
  return std::isfinite(sigma) ? std::max(sigma, kFloorPx) : kDefaultPx;
}

std::optional<Eigen::Vector3d> usable_ray(const Camera& camera,
                                          const TrackObservation& observation) {
  if (!observation.pixel.allFinite()) return std::nullopt;
  return camera.unproject(observation.pixel);
}

int MapData::add_keyframe(const FramePtr& frame, int segment, const Pose& T_world_camera,
                          const std::vector<TrackObservation>& observations) {
  const int k = static_cast<int>(keyframes.size());
  MapKeyframe keyframe;
  keyframe.frame = std::make_shared<const StoredFrame>(frame);
  keyframe.segment = segment;
  keyframe.T_world_camera = T_world_camera;
  keyframe.tracks.reserve(observations.size());
  for (const TrackObservation& o : observations) {
    const auto ray = usable_ray(camera, o);
    if (!ray) continue;
    MapTrack& track = tracks[o.track];
    if (track.dead) continue;
    if (!track.views.empty() && track.views.back().keyframe >= k) continue;  // named twice
    track.views.push_back({k, o.pixel, *ray, floored_sigma_px(o)});
    keyframe.tracks.push_back(o.track);
  }
  keyframes.push_back(std::move(keyframe));
  return k;
}

void MapData::make_landmark(MapTrack& track, const Triangulation& point) {
  CORVID_CHECK(point.status == TriangulationStatus::ok && !track.views.empty(), "no point");
  track.landmark = true;
  track.p_world = point.p_world;
  track.max_ray_angle_rad = point.max_ray_angle_rad;
  track.strikes = 0;
  const KeyframeView& newest = track.views.back();
  track.colour =
      colour_at(*keyframes[static_cast<std::size_t>(newest.keyframe)].frame->load(), newest.pixel);
  for (const KeyframeView& v : track.views) {
    keyframes[static_cast<std::size_t>(v.keyframe)].published = nullptr;
  }
}

void MapData::drop_landmark(MapTrack& track) {
  if (!track.landmark) return;
  track.landmark = false;
  for (const KeyframeView& v : track.views) {
    keyframes[static_cast<std::size_t>(v.keyframe)].published = nullptr;
  }
}

void MapData::drop_view(MapTrack& track, std::size_t view) {
  keyframes[static_cast<std::size_t>(track.views[view].keyframe)].published = nullptr;
  track.views.erase(track.views.begin() + static_cast<std::ptrdiff_t>(view));
}

std::vector<RayView> MapData::ray_views(const MapTrack& track) const {
  std::vector<RayView> views;
  views.reserve(track.views.size());
  for (const KeyframeView& v : track.views) {
    views.push_back({keyframes[static_cast<std::size_t>(v.keyframe)].T_world_camera, v.pixel,
                     v.ray_camera, v.sigma_px});
  }
  return views;
}

int MapData::triangulate_tracks(int k, double min_angle_rad, double max_error_px) {
  constexpr int kMaxFailures = 3;
  int made = 0;
  const MapKeyframe& keyframe = keyframes[static_cast<std::size_t>(k)];
  for (const TrackId id : keyframe.tracks) {
    MapTrack& track = tracks[id];
    if (track.landmark || track.dead || track.views.size() < 2) continue;
    const Triangulation point = triangulate(camera, ray_views(track), min_angle_rad, max_error_px);
    if (point.status == TriangulationStatus::ok) {
      make_landmark(track, point);
      ++made;
    } else if (point.status != TriangulationStatus::degenerate &&
               ++track.failures >= kMaxFailures) {
      track.dead = true;
    }
  }
  return made;
}

void MapData::forget_tracks(int k) {
  if (k < 0) return;
  for (const TrackId id : keyframes[static_cast<std::size_t>(k)].tracks) {
    const auto it = tracks.find(id);
    if (it == tracks.end() || it->second.landmark) continue;
    if (it->second.views.empty() || it->second.views.back().keyframe <= k) tracks.erase(it);
  }
}

void MapData::erase_track(TrackId id) {
  tracks.erase(id);
  stale_landmarks.insert(chunk_of(id));
}

void MapData::set_camera(const Camera& refined) {
  camera = refined;
  for (auto& [id, track] : tracks) {
    for (KeyframeView& v : track.views) {
      if (const auto ray = camera.unproject(v.pixel)) v.ray_camera = *ray;
    }
  }
}

std::shared_ptr<const MapSnapshot> MapData::snapshot(std::uint64_t version) {
  auto out = std::make_shared<MapSnapshot>();
  out->version = version;
  out->camera = std::make_shared<const Camera>(camera);
  out->keyframes.reserve(keyframes.size());
  for (std::size_t k = 0; k < keyframes.size(); ++k) {
    MapKeyframe& keyframe = keyframes[k];
    if (keyframe.published && !keyframe.renamed.empty()) keyframe.published = renamed(keyframe);
    keyframe.renamed.clear();
    if (keyframe.published && moved(keyframe)) keyframe.published = replaced(keyframe);
    if (!keyframe.published) {
      auto copy = std::make_shared<Keyframe>();
      copy->id = KeyframeId(static_cast<std::uint32_t>(k));
      copy->segment = keyframe.segment;
      copy->frame = keyframe.frame;
      copy->T_world_camera = keyframe.T_world_camera;
      for (const TrackId id : keyframe.tracks) {
        stale_landmarks.insert(chunk_of(id));
        const auto it = tracks.find(id);
        if (it == tracks.end() || !it->second.landmark) continue;
        const auto& views = it->second.views;
        const auto view =
            std::lower_bound(views.begin(), views.end(), static_cast<int>(k),
                             [](const KeyframeView& v, int index) { return v.keyframe < index; });
        if (view == views.end() || view->keyframe != static_cast<int>(k)) continue;
        copy->observations.push_back({LandmarkId(id.value), view->pixel});
      }
      keyframe.published = std::move(copy);
    }
    out->keyframes.push_back(keyframe.published);
  }
  publish_landmarks(*this);
  std::vector<Landmarks::Chunk> chunks;
  chunks.reserve(published_landmarks.size());
  for (const auto& [key, chunk] : published_landmarks) chunks.push_back(chunk);
  out->landmarks = Landmarks(std::move(chunks));
  return out;
}

void MapData::append(MapData&& other) {
  const int offset = static_cast<int>(keyframes.size());
  for (auto& [id, track] : other.tracks) {
    for (KeyframeView& v : track.views) v.keyframe += offset;
    const auto old = tracks.find(id);
    if (old != tracks.end()) {
      drop_landmark(old->second);
      old->second = std::move(track);
    } else {
      tracks.emplace(id, std::move(track));
    }
  }
  for (MapKeyframe& keyframe : other.keyframes) {
    keyframe.published = nullptr;
    keyframes.push_back(std::move(keyframe));
  }
  set_camera(other.camera);
  other = {};
}

}  // namespace corvid
