#include "backend/backend_impl.h"

#include <algorithm>

#include "core/log.h"
#include "core/median.h"

namespace corvid {
namespace {

constexpr int kUntrackedStride = 5;      ///< of the frames that are looked for while lost
constexpr std::size_t kMostWaiting = 8;  ///< of them whose answer may still come

}  // namespace

void Backend::Impl::choose_query(const FrameTracks& tracks, bool keyframe_of_map) {
  query.reset();
  if (map.keyframes.empty()) return;
  const bool untracked = mode == Mode::starting || lost_frames > 0;
  if (!untracked) {
    waiting.clear();
    if (keyframe_of_map) query = tracks;
    return;
  }
  if (tracks.observations.size() < static_cast<std::size_t>(options.min_inliers)) return;
  if (!tracks.keyframe && tracks.frame->id.value % kUntrackedStride != 0) return;
  query = tracks;
  waiting.push_back(tracks);
  if (waiting.size() > kMostWaiting) waiting.pop_front();
}

void Backend::Impl::recognise(const PlaceMatch& match) {
  if (match.references.empty()) return;
  timings.clear();
  watch = Stopwatch();
  const auto in_map = std::find_if(map.keyframes.rbegin(), map.keyframes.rend(),
                                   [&](const auto& k) { return k.frame->id == match.query; });
  const auto lost = std::find_if(waiting.begin(), waiting.end(),
                                 [&](const auto& t) { return t.frame->id == match.query; });
  const PlacePose place = place_pose(map, fused, match, options);
  std::string refusal = place.refusal;
  bool changed = false;
  if (place.ok && in_map != map.keyframes.rend() && in_map->host) {
    refusal = "the keyframe rests by now";
  } else if (place.ok && in_map != map.keyframes.rend()) {
    const int k = static_cast<int>(map.keyframes.rend() - in_map) - 1;
    const int segment_of_query = map.keyframes[static_cast<std::size_t>(k)].segment;
    const PlaceOutcome outcome = recognise_keyframe(map, frames, fused, k, place, options, threads);
    refusal = outcome.reason;
    using Kind = PlaceOutcome::Kind;
    changed = outcome.kind == Kind::loop || outcome.kind == Kind::merge;
    places.connections += outcome.kind == Kind::connected ? 1 : 0;
    places.loops += outcome.kind == Kind::loop ? 1 : 0;
    places.merges += outcome.kind == Kind::merge ? 1 : 0;
    if (outcome.kind == Kind::merge) {
      positions.forget_segment(outcome.from);
      doubt.join(outcome.from, outcome.to, outcome.scale);
    }
    const bool jumped = (outcome.kind == Kind::loop && segment_of_query == segment) ||
                        (outcome.kind == Kind::merge && outcome.from == segment);
    if (jumped) {
      if (outcome.kind == Kind::merge) enter_segment(outcome.to);
      median_depth *= outcome.scale;
      doubt.jump();
      ++resets;
    }
    // A mere connection fits already: the next keyframe's adjustment has it.
    if (outcome.kind == Kind::connected) publish_motion(newest_observations);
    if (changed && mode == Mode::tracking) adjust_newest();
  } else if (place.ok && lost != waiting.end()) {
    const FrameTracks tracks = *lost;
    changed = relocalize(tracks, place);
    if (changed) {
      ++places.relocalizations;
      ++resets;
    }
  }
  if (!refusal.empty()) {
    ++places.refused;
    log().debug("frame {}: the place is refused: {}", match.query.value, refusal);
  }
  lap("backend/place");
  if (!changed) return;
  publish_map();
  publish_motion(newest_observations);
}

/// What follows belongs to an older segment.
void Backend::Impl::enter_segment(int older) {
  segment = older;
  const auto first = std::find_if(map.keyframes.begin(), map.keyframes.end(),
                                  [&](const MapKeyframe& k) { return k.segment == older; });
  segment_first = static_cast<int>(first - map.keyframes.begin());
}

/// A frame that was not in the map is recognised: it becomes a keyframe of the segment where it is.
bool Backend::Impl::relocalize(const FrameTracks& tracks, const PlacePose& place) {
  const bool untracked = mode == Mode::starting || lost_frames > 0;
  if (!untracked || (!frames.empty() && frames.back().time_ns >= tracks.frame->time_ns))
    return false;
  const Pose T_camera_world = place.T_world_query.inverse();
  std::vector<TrackObservation> kept;
  for (const TrackObservation& o : tracks.observations) {
    const auto it = map.tracks.find(o.track);
    if (it != map.tracks.end() && it->second.landmark) {
      const auto pixel = map.camera.project(T_camera_world * it->second.p_world);
      if (!pixel || (*pixel - o.pixel).norm() > options.max_error_px) {
        it->second.dead = true;  // what the track follows is not its landmark any more
        continue;
      }
    } else if (it != map.tracks.end()) {  // seen since the camera was lost, from nobody knows where
      while (!it->second.views.empty()) map.drop_view(it->second, it->second.views.size() - 1);
    }
    kept.push_back(o);
  }
  enter_segment(place.segment);
  segment_first_frame = frames.size();
  mode = Mode::tracking;
  lost_frames = 0;
  starter.clear();
  waiting.clear();
  const int k = map.add_keyframe(tracks.frame, segment, place.T_world_query, kept);
  const MapKeyframe& reference = map.keyframes[static_cast<std::size_t>(place.reference)];
  Drift& drift = map.keyframes.back().drift;
  drift = reference.drift.seen_from(reference.T_world_camera.inverse() * place.T_world_query);
  drift.covariance.topLeftCorner<6, 6>() += kObservationsPerFact * place.covariance;
  doubt.jump();
  frames.push_back({tracks.frame->id, tracks.frame->time_ns, k, Pose()});
  connect_place(map, k, place, kept, fused);
  guess_points(map, k, place, kept, fused);
  std::vector<double> depths;
  for (const PlaceInlier& i : place.inliers)
    if (const auto it = map.tracks.find(resolve(fused, i.landmark)); it != map.tracks.end())
      depths.push_back((T_camera_world * it->second.p_world).norm());
  median_depth = upper_median(std::move(depths));
  return true;
}

}  // namespace corvid
