#include "backend/backend.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <optional>
#include <span>
#include <thread>

#include "backend/map_data.h"
#include "backend/places.h"
#include "backend/resect.h"
#include "backend/start.h"
#include "backend/window.h"
#include "core/check.h"
#include "core/log.h"
#include "core/median.h"
#include "core/stopwatch.h"

namespace corvid {
namespace {

constexpr int kMaxLostFrames = 15;    ///< then a new segment starts
constexpr double kMinShare = 0.2;     ///< of the landmarks must agree with a pose
constexpr double kGoodShare = 0.4;    ///< fewer: degraded
constexpr int kMaxStrikes = 3;        ///< frames in a row in which a track may disagree
constexpr int kIntrinsicsFrom = 6;    ///< keyframes before intrinsics are refined
constexpr int kIntrinsicsUntil = 30;  ///< keyframes after which windows leave them alone
/// Keyframes at which the distortion alone is refined.
constexpr std::array kDistortionAt{6, 9, 13, 20, 30};
constexpr int kUntrackedStride = 5;      ///< of the frames that are looked for while lost
constexpr std::size_t kMostWaiting = 8;  ///< of them whose answer may still come

}  // namespace

struct Backend::Impl {
  Impl(const BackendOptions& o, IntrinsicsOrigin intrinsics, int thread_count)
      : options(o), origin(intrinsics), threads(thread_count) {
    if (threads <= 0) threads = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  }

  /// Landmarks seen in a frame.
  struct Sighting {
    std::vector<PointView> points;
    std::vector<TrackId> tracks;
  };

  PoseEvent add(const FrameTracks& tracks);
  void add_starting(const FrameTracks& tracks, PoseEvent* event);
  void add_tracking(const FrameTracks& tracks, PoseEvent* event);
  void add_lost(const FrameTracks& tracks, std::string reason, PoseEvent* event);
  void insert_keyframe(const FrameTracks& tracks, const std::vector<TrackId>& outliers,
                       const Pose& T_world_camera);
  [[nodiscard]] Sighting sight(const FrameTracks& tracks) const;
  [[nodiscard]] std::optional<Pose> predict(std::int64_t time_ns) const;
  [[nodiscard]] bool jumps(const Resection& r, std::size_t points, std::int64_t time_ns) const;
  [[nodiscard]] Pose pose_of(const FrameRecord& record) const;
  [[nodiscard]] IntrinsicsPolicy intrinsics_policy() const;
  [[nodiscard]] IntrinsicsPolicy final_intrinsics_policy() const;
  [[nodiscard]] bool wide_enough(std::vector<double> ray_angles_rad) const;
  [[nodiscard]] int segment_keyframes() const {
    return static_cast<int>(map.keyframes.size()) - segment_first;
  }
  void adjust_newest();
  void enter_segment(int older);
  void choose_query(const FrameTracks& tracks, bool keyframe_of_map);
  void recognise(const PlaceMatch& match);
  [[nodiscard]] bool relocalize(const FrameTracks& tracks, const PlacePose& place);
  void publish_motion(std::span<const TrackObservation> observations);
  void publish_map();
  void lap(const char* part) { timings.emplace_back(part, watch.lap_ms()); }

  BackendOptions options;
  IntrinsicsOrigin origin;
  IntrinsicsFreedom freedom = IntrinsicsFreedom::fixed;  ///< of the first frame's camera
  int threads;

  enum class Mode { starting, tracking } mode = Mode::starting;
  MapData map;
  Camera prior;  ///< intrinsics as the source gave them
  bool have_camera = false;
  Starter starter;
  int segment = 0, segment_first = 0;
  int newest_segment = 0;  ///< highest number given so far
  std::vector<FrameRecord> frames;
  std::size_t segment_first_frame = 0;  ///< in `frames`
  int lost_frames = 0;
  double median_depth = 1;  ///< of the last good frame's landmarks
  std::uint64_t version = 0, resets = 0;
  FusedTracks fused;
  PlaceCounts places;
  std::optional<FrameTracks> query;
  std::deque<FrameTracks> waiting;  ///< queries that are not in the map, oldest first
  std::vector<TrackObservation> newest_observations;
  std::shared_ptr<const MapSnapshot> published_map = std::make_shared<MapSnapshot>();
  std::shared_ptr<const MotionState> published_motion = std::make_shared<MotionState>();
  Timings timings;
  Stopwatch watch;
};

PoseEvent Backend::Impl::add(const FrameTracks& tracks) {
  CORVID_CHECK(tracks.frame && tracks.frame->camera, "a frame needs a camera");
  CORVID_CHECK(std::is_sorted(tracks.observations.begin(), tracks.observations.end(),
                              [](const auto& a, const auto& b) { return a.track < b.track; }),
               "observations are sorted by track");
  timings.clear();
  watch = Stopwatch();
  if (!have_camera) {
    freedom = intrinsics_freedom(options.intrinsics, origin, *tracks.frame->camera);
    prior = adjustable(*tracks.frame->camera, freedom);
    map.camera = prior;
    have_camera = true;
  }
  PoseEvent event;
  event.frame = tracks.frame->id;
  event.time_ns = tracks.frame->time_ns;
  event.tracks = static_cast<int>(tracks.observations.size());
  event.keyframe = tracks.keyframe;
  if (mode == Mode::starting) {
    add_starting(tracks, &event);
  } else {
    add_tracking(tracks, &event);
  }
  event.segment = segment;
  event.resets = resets;
  choose_query(tracks, event.keyframe);
  newest_observations = tracks.observations;
  publish_motion(newest_observations);
  return event;
}

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
  if (place.ok && in_map != map.keyframes.rend()) {
    const int k = static_cast<int>(map.keyframes.rend() - in_map) - 1;
    const PlaceOutcome outcome = recognise_keyframe(map, frames, fused, k, place, options, threads);
    refusal = outcome.reason;
    using Kind = PlaceOutcome::Kind;
    places.connections += outcome.kind == Kind::connected ? 1 : 0;
    places.loops += outcome.kind == Kind::loop ? 1 : 0;
    places.merges += outcome.kind == Kind::merge ? 1 : 0;
    if (outcome.kind == Kind::merge && outcome.from == segment) enter_segment(outcome.to);
    if (outcome.kind == Kind::loop || outcome.kind == Kind::merge) {
      median_depth *= outcome.scale;
      ++resets;
    }
    if (outcome.kind != Kind::refused && mode == Mode::tracking) adjust_newest();
  } else if (place.ok && lost != waiting.end()) {
    const FrameTracks tracks = *lost;
    if (relocalize(tracks, place)) {
      ++places.relocalizations;
      ++resets;
    }
  }
  if (!refusal.empty()) {
    ++places.refused;
    log().debug("frame {}: the place is refused: {}", match.query.value, refusal);
  }
  lap("backend/place");
  publish_map();
  publish_motion(newest_observations);
}

void Backend::Impl::add_starting(const FrameTracks& tracks, PoseEvent* event) {
  starter.hold(tracks);
  event->state = TrackingState::starting;
  event->keyframe = false;  // not of the map, unless the start succeeds
  if (!starter.newest_is_keyframe()) {
    event->reason = starter.reason();
    return;
  }
  const Pose T_first = frames.empty() ? Pose() : pose_of(frames.back());
  std::optional<StartedMap> started =
      starter.attempt(map.camera, segment, T_first, median_depth, options, threads);
  lap("backend/start");
  if (!started) {
    event->reason = starter.reason();
    return;
  }
  segment_first = static_cast<int>(map.keyframes.size());
  segment_first_frame = frames.size();
  for (FrameRecord record : started->frames) {
    record.keyframe += segment_first;
    frames.push_back(record);
  }
  map.append(std::move(started->map));
  starter.clear();
  mode = Mode::tracking;
  lost_frames = 0;
  publish_map();

  const MapKeyframe& newest = map.keyframes.back();
  const Sighting seen = sight(tracks);
  event->state = TrackingState::tracking;
  event->keyframe = true;
  event->T_world_camera = newest.T_world_camera;
  event->covariance = newest.covariance;
  double sum = 0;
  for (const PointView& p : seen.points) {
    const auto pixel = map.camera.project(newest.T_world_camera.inverse() * p.p_world);
    if (!pixel) continue;
    const double e2 = (*pixel - p.pixel).squaredNorm();
    if (e2 >= options.max_error_px * options.max_error_px) continue;
    ++event->inliers;
    sum += e2;
  }
  event->mse_px2 = event->inliers > 0 ? sum / event->inliers : 0;
}

Backend::Impl::Sighting Backend::Impl::sight(const FrameTracks& tracks) const {
  Sighting seen;
  for (const TrackObservation& o : tracks.observations) {
    const auto it = map.tracks.find(o.track);
    if (it == map.tracks.end() || !it->second.landmark || it->second.dead) continue;
    if (!o.pixel.allFinite()) continue;
    seen.points.push_back({it->second.p_world, o.pixel, floored_sigma_px(o)});
    seen.tracks.push_back(o.track);
  }
  return seen;
}

Pose Backend::Impl::pose_of(const FrameRecord& record) const {
  return map.keyframes[static_cast<std::size_t>(record.keyframe)].T_world_camera *
         record.T_keyframe_frame;
}

std::optional<Pose> Backend::Impl::predict(std::int64_t time_ns) const {
  if (frames.size() <= segment_first_frame) return std::nullopt;
  const Pose newest = pose_of(frames.back());
  if (frames.size() < segment_first_frame + 2) return newest;
  const FrameRecord& before = frames[frames.size() - 2];
  const auto step_ns = static_cast<double>(frames.back().time_ns - before.time_ns);
  const auto ahead_ns = static_cast<double>(time_ns - frames.back().time_ns);
  if (!(step_ns > 0) || !(ahead_ns > 0) || ahead_ns > 3 * step_ns) return newest;
  const Vector6d step = (pose_of(before).inverse() * newest).log();
  return newest * Pose::exp(step * (ahead_ns / step_ns));
}

/// A step ten times as fast as the last ones, that not even most landmarks agree with.
bool Backend::Impl::jumps(const Resection& r, std::size_t points, std::int64_t time_ns) const {
  constexpr std::size_t kSteps = 10;
  constexpr double kTimesFaster = 10, kMostShare = 0.6;
  if (r.inliers >= kMostShare * static_cast<double>(points)) return false;
  const auto seconds = [](std::int64_t ns) { return 1e-9 * static_cast<double>(ns); };
  std::vector<double> speeds;
  const std::size_t first = std::max(
      segment_first_frame, frames.size() > kSteps ? frames.size() - kSteps : std::size_t{0});
  for (std::size_t i = first + 1; i < frames.size(); ++i) {
    const double dt = seconds(frames[i].time_ns - frames[i - 1].time_ns);
    const double step =
        (pose_of(frames[i]).translation() - pose_of(frames[i - 1]).translation()).norm();
    if (dt > 0) speeds.push_back(step / dt);
  }
  const double dt = seconds(time_ns - frames.back().time_ns);
  if (speeds.size() < 3 || !(dt > 0)) return false;
  const double speed =
      (r.T_world_camera.translation() - pose_of(frames.back()).translation()).norm() / dt;
  // A hovering camera may start to move: speeds far below one scene depth per 10 s are no jump.
  return speed > kTimesFaster * std::max(upper_median(std::move(speeds)), 0.01 * median_depth);
}

void Backend::Impl::add_lost(const FrameTracks& tracks, std::string reason, PoseEvent* event) {
  ++lost_frames;
  event->state = TrackingState::lost;
  event->reason = std::move(reason);
  event->keyframe = false;
  starter.hold(tracks);  // so that a new segment can begin where this one ended
  // A frame without any track says nothing: the frontend keeps its tracks through a dark moment.
  const bool none_left = !tracks.observations.empty() && sight(tracks).points.empty();
  if (!none_left && lost_frames <= kMaxLostFrames) return;
  segment = ++newest_segment;
  mode = Mode::starting;
  event->reason += "; a new map segment starts";
  if (none_left) {  // what was held before shares nothing with what comes
    starter.clear();
    starter.hold(tracks);
  }
}

void Backend::Impl::add_tracking(const FrameTracks& tracks, PoseEvent* event) {
  const Sighting seen = sight(tracks);
  ResectSettings settings;
  settings.max_error_px = options.max_error_px;
  settings.huber_px = options.huber_px;
  settings.min_inliers = options.min_inliers;
  settings.seed = options.seed;
  const Resection r = resect(map.camera, seen.points, predict(tracks.frame->time_ns), settings);
  lap("backend/resect");
  const auto visible = static_cast<double>(seen.points.size());
  if (seen.points.size() < static_cast<std::size_t>(options.min_inliers)) {
    return add_lost(tracks, "too few landmarks are in view", event);
  }
  if (!r.ok || r.inliers < kMinShare * visible) {
    return add_lost(tracks, "too few landmarks agree with one pose", event);
  }
  if (jumps(r, seen.points.size(), tracks.frame->time_ns)) {
    return add_lost(tracks, "the pose would jump", event);
  }
  if (lost_frames > 0) starter.clear();
  lost_frames = 0;

  std::vector<TrackId> outliers;
  std::vector<double> depths;
  const Pose T_camera_world = r.T_world_camera.inverse();
  for (std::size_t i = 0; i < seen.tracks.size(); ++i) {
    MapTrack& track = map.tracks.find(seen.tracks[i])->second;
    if (r.inlier[i] != 0) {
      track.strikes = 0;
      depths.push_back((T_camera_world * track.p_world).norm());
    } else {
      outliers.push_back(seen.tracks[i]);
      if (++track.strikes >= kMaxStrikes) track.dead = true;
    }
  }
  median_depth = upper_median(std::move(depths));

  event->inliers = r.inliers;
  event->mse_px2 = r.mse_px2;
  if (r.inliers < 2 * options.min_inliers) {
    event->state = TrackingState::degraded;
    event->reason = "few landmarks are in view";
  } else if (r.inliers < kGoodShare * visible) {
    event->state = TrackingState::degraded;
    event->reason = "many landmarks disagree with the pose";
  } else {
    event->state = TrackingState::tracking;
  }
  if (tracks.keyframe) {
    insert_keyframe(tracks, outliers, r.T_world_camera);
    event->T_world_camera = map.keyframes.back().T_world_camera;
    event->covariance = map.keyframes.back().covariance;
    return;
  }
  const MapKeyframe& reference = map.keyframes.back();
  const Pose T_keyframe_frame = reference.T_world_camera.inverse() * r.T_world_camera;
  frames.push_back({tracks.frame->id, tracks.frame->time_ns,
                    static_cast<int>(map.keyframes.size()) - 1, T_keyframe_frame});
  event->T_world_camera = r.T_world_camera;
  // The keyframe's uncertainty is carried over to the frame, the landmarks' share included in it.
  const Matrix6d Ad = T_keyframe_frame.inverse().adjoint();
  event->covariance = r.covariance + Ad * reference.covariance * Ad.transpose();
}

/// For the adjustment after a new keyframe, while the intrinsics settle.
IntrinsicsPolicy Backend::Impl::intrinsics_policy() const {
  IntrinsicsPolicy policy;
  policy.prior = prior;
  const int n = segment_keyframes();
  if (n < kIntrinsicsFrom || n > kIntrinsicsUntil) return policy;
  if (freedom == IntrinsicsFreedom::distortion) {
    // adjust_window() itself refuses what is not beyond doubt; a few attempts are enough.
    if (std::find(kDistortionAt.begin(), kDistortionAt.end(), n) != kDistortionAt.end())
      policy.freedom = freedom;
    return policy;
  }
  std::vector<double> angles;
  for (const TrackId id : map.keyframes.back().tracks) {
    const auto it = map.tracks.find(id);
    if (it != map.tracks.end() && it->second.landmark) {
      angles.push_back(it->second.max_ray_angle_rad);
    }
  }
  if (wide_enough(std::move(angles))) policy.freedom = freedom;
  return policy;
}

/// Over the whole map, for the last adjustment.
IntrinsicsPolicy Backend::Impl::final_intrinsics_policy() const {
  IntrinsicsPolicy policy;
  policy.prior = prior;
  if (map.keyframes.size() < static_cast<std::size_t>(kIntrinsicsFrom)) return policy;
  std::vector<double> angles;
  for (const auto& [id, track] : map.tracks) {
    if (track.landmark) angles.push_back(track.max_ray_angle_rad);
  }
  if (freedom == IntrinsicsFreedom::distortion || wide_enough(std::move(angles)))
    policy.freedom = freedom;
  return policy;
}

/// Intrinsics and a flat fan of rays cannot be told apart.
bool Backend::Impl::wide_enough(std::vector<double> ray_angles_rad) const {
  return upper_median(std::move(ray_angles_rad)) > 2 * options.start_min_parallax_rad;
}

void Backend::Impl::insert_keyframe(const FrameTracks& tracks, const std::vector<TrackId>& outliers,
                                    const Pose& T_world_camera) {
  std::vector<TrackObservation> kept;
  kept.reserve(tracks.observations.size());
  std::set_difference(tracks.observations.begin(), tracks.observations.end(), outliers.begin(),
                      outliers.end(), std::back_inserter(kept), [](const auto& a, const auto& b) {
                        const auto id = [](const auto& x) {
                          if constexpr (std::is_same_v<std::decay_t<decltype(x)>, TrackId>) {
                            return x;
                          } else {
                            return x.track;
                          }
                        };
                        return id(a) < id(b);
                      });
  const int k = map.add_keyframe(tracks.frame, segment, T_world_camera, kept);
  frames.push_back({tracks.frame->id, tracks.frame->time_ns, k, Pose()});
  map.triangulate_tracks(k, options.min_angle_rad, options.max_error_px);
  lap("backend/triangulate");
  adjust_newest();
  map.forget_tracks(k - options.window_keyframes);
  lap("backend/adjust");
  publish_map();
}

/// Window adjustment around the newest keyframe.
void Backend::Impl::adjust_newest() {
  // While the intrinsics settle everything moves with them; later they stay, and so does the past.
  const IntrinsicsPolicy policy = intrinsics_policy();
  const bool settling =
      freedom == IntrinsicsFreedom::all && segment_keyframes() <= kIntrinsicsUntil;
  const int count = settling || policy.freedom != IntrinsicsFreedom::fixed
                        ? segment_keyframes()
                        : options.window_keyframes;
  adjust_window(map, segment_first, count, options, threads, policy);
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
      if (!pixel || (*pixel - o.pixel).norm() > options.max_error_px) continue;
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
  const Matrix6d Ad = (T_camera_world * reference.T_world_camera).adjoint();
  map.keyframes.back().covariance = place.covariance + Ad * reference.covariance * Ad.transpose();
  frames.push_back({tracks.frame->id, tracks.frame->time_ns, k, Pose()});
  connect_place(map, k, place, kept, fused);
  guess_points(map, k, place, kept);
  std::vector<double> depths;
  for (const PlaceInlier& i : place.inliers)
    if (const auto it = map.tracks.find(resolve(fused, i.landmark)); it != map.tracks.end())
      depths.push_back((T_camera_world * it->second.p_world).norm());
  median_depth = upper_median(std::move(depths));
  return true;
}

void Backend::Impl::publish_motion(std::span<const TrackObservation> observations) {
  auto motion = std::make_shared<MotionState>();
  if (mode == Mode::tracking && lost_frames == 0) {
    const std::size_t count = std::min<std::size_t>(2, frames.size() - segment_first_frame);
    for (std::size_t i = frames.size() - count; i < frames.size(); ++i) {
      motion->recent.push_back({frames[i].time_ns, pose_of(frames[i])});
    }
  }
  if (mode == Mode::tracking) {
    const std::size_t kept = static_cast<std::size_t>(2 * options.window_keyframes);
    const std::size_t all = map.keyframes.size(), first = static_cast<std::size_t>(segment_first);
    for (std::size_t k = std::max(first, all > kept ? all - kept : 0); k < all; ++k)
      motion->keyframes.emplace_back(map.keyframes[k].frame->id, map.keyframes[k].T_world_camera);
    if (freedom != IntrinsicsFreedom::fixed) motion->camera = published_map->camera;
  }
  for (const TrackObservation& o : observations) {
    const auto it = map.tracks.find(o.track);
    if (it == map.tracks.end()) continue;
    if (it->second.dead) {
      motion->rejected.push_back(o.track);
    } else if (it->second.landmark && mode == Mode::tracking) {
      motion->landmarks.emplace_back(o.track, it->second.p_world);
    }
  }
  published_motion = std::move(motion);
}

void Backend::Impl::publish_map() { published_map = map.snapshot(++version); }

Backend::Backend(const BackendOptions& options, IntrinsicsOrigin origin, int threads)
    : impl_(std::make_unique<Impl>(options, origin, threads)) {
  const auto problems = options.validate();
  CORVID_CHECK(problems.empty(), problems.front());
}

Backend::~Backend() = default;

PoseEvent Backend::add(const FrameTracks& tracks) { return impl_->add(tracks); }

const std::optional<FrameTracks>& Backend::place_query() const { return impl_->query; }

void Backend::recognise(const PlaceMatch& match) { impl_->recognise(match); }

const PlaceCounts& Backend::places() const { return impl_->places; }

std::shared_ptr<const MotionState> Backend::motion() const { return impl_->published_motion; }

std::shared_ptr<const MapSnapshot> Backend::map() const { return impl_->published_map; }

void Backend::finish() {
  Impl& b = *impl_;
  if (!b.options.final_adjustment || b.map.keyframes.empty()) return;
  adjust_all(b.map, b.options, b.threads, b.final_intrinsics_policy());
  b.publish_map();
}

Trajectory Backend::trajectory() const {
  Trajectory trajectory;
  trajectory.reserve(impl_->frames.size());
  for (const FrameRecord& record : impl_->frames) {
    trajectory.push_back({record.time_ns, impl_->pose_of(record)});
  }
  return trajectory;
}

std::vector<std::pair<std::string, double>> Backend::last_timings_ms() const {
  return impl_->timings;
}

}  // namespace corvid
