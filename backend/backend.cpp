#include "backend/backend.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <thread>

#include "backend/backend_impl.h"
#include "core/check.h"
#include "core/median.h"

namespace corvid {
namespace {

constexpr int kMaxLostFrames = 15;     ///< then a new segment starts
constexpr double kMinShare = 0.2;      ///< of the landmarks must agree with a pose
constexpr double kGoodShare = 0.4;     ///< fewer: degraded
constexpr double kSurelyWrong = 0.99;  ///< probability that makes a calibration a wrong one
constexpr int kRestingWindows = 3;     ///< windows after which a keyframe may rest
constexpr int kMaxStrikes = 3;         ///< frames in a row in which a track may disagree

/// Factor on the covariance of a pose that rests on a small part of what is tracked: when the world
/// agrees, 80 % and more do.
double unexplained(const PoseEvent& event) {
  constexpr double kUsualShare = 0.8;
  const double times = kUsualShare * event.tracks / std::max(1, event.inliers);
  return std::max(1.0, times * times);
}

}  // namespace

PoseEvent Backend::Impl::add(const FrameTracks& tracks) {
  CORVID_CHECK(tracks.frame && tracks.frame->camera, "a frame needs a camera");
  CORVID_CHECK(std::is_sorted(tracks.observations.begin(), tracks.observations.end(),
                              [](const auto& a, const auto& b) { return a.track < b.track; }),
               "observations are sorted by track");
  timings.clear();
  watch = Stopwatch();
  if (!have_camera) {
    freedom = intrinsics_freedom(options.intrinsics, origin, *tracks.frame->camera);
    focal = FocalBelief(freedom != IntrinsicsFreedom::all);
    prior = adjustable(*tracks.frame->camera, freedom);
    map.camera = prior;
    have_camera = true;
  }
  PoseEvent event;
  event.frame = tracks.frame->id;
  event.time_ns = tracks.frame->time_ns;
  event.tracks = static_cast<int>(tracks.observations.size());
  event.keyframe = tracks.keyframe;
  if (!tracks.frame->blind.empty()) {
    add_blind(tracks, &event);
    return event;
  }
  const bool stale =
      newest_frame && !newest_frame->grey.empty() && newest_frame->grey == tracks.frame->grey;
  newest_frame = tracks.frame;
  if (mode == Mode::starting) {
    add_starting(tracks, &event);
  } else if (stale && lost_frames == 0) {
    add_stale(tracks, &event);
  } else {
    add_tracking(tracks, &event);
  }
  place_event(&event);
  choose_query(tracks, event.keyframe);
  newest_observations = tracks.observations;
  publish_motion(newest_observations);
  return event;
}

/// What every event says of its map.
void Backend::Impl::place_event(PoseEvent* event) const {
  event->segment = segment;
  event->placement = positions.placement(segment);
  if (event->placement) event->scale = event->placement->scale;
  event->resets = resets;
}

/// The camera is away: where it goes meanwhile nobody knows. Its tracks may be found again when it
/// is back, so nothing is given up, however long that takes.
void Backend::Impl::add_blind(const FrameTracks& tracks, PoseEvent* event) {
  event->reason = tracks.frame->blind;
  event->keyframe = false;
  if (mode == Mode::tracking) {
    event->state = TrackingState::lost;
    lost_frames = std::max(lost_frames, 1);
  }
  place_event(event);
  query.reset();
  newest_observations.clear();
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
  doubt.start(segment);
  if (segment > 0) ++resets;
  learn_focal();
  publish_map();

  const MapKeyframe& newest = map.keyframes.back();
  const Sighting seen = sight(tracks);
  event->keyframe = true;
  event->T_world_camera = newest.T_world_camera;
  event->covariance = newest.drift.pose_covariance(focal.square());
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
  event->covariance *= unexplained(*event);
  judge(static_cast<double>(seen.points.size()), false, event);
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

/// A picture that is the one before to the last bit, noise included, shows an earlier moment: the
/// camera's driver has repeated it. The pose is foretold from the motion before, as long as that
/// motion stays small against the scene.
void Backend::Impl::add_stale(const FrameTracks& tracks, PoseEvent* event) {
  event->keyframe = false;
  const MapKeyframe& reference = map.keyframes.back();
  const auto foretold = predict(tracks.frame->time_ns);
  constexpr double kFarthest = 0.05;  // of the landmarks' depth, and [rad]
  if (!foretold || !foretold->motion ||
      foretold->motion->head<3>().norm() > kFarthest * median_depth ||
      foretold->motion->tail<3>().norm() > kFarthest) {
    event->state = TrackingState::lost;
    event->reason = "the pictures have been the same for too long to foretell the pose";
    return;
  }
  event->state = TrackingState::degraded;
  event->reason = "the picture is the same as the one before: the pose is foretold";
  const Vector6d& motion = *foretold->motion;
  const Pose T_keyframe_frame = reference.T_world_camera.inverse() * foretold->T_world_camera;
  frames.push_back({tracks.frame->id, tracks.frame->time_ns,
                    static_cast<int>(map.keyframes.size()) - 1, T_keyframe_frame, true});
  event->T_world_camera = foretold->T_world_camera;
  // The camera may as well have stopped, or gone twice as fast; and a part of that to any side.
  event->covariance = reference.drift.seen_from(T_keyframe_frame).pose_covariance(focal.square()) +
                      motion * motion.transpose();
  constexpr double kAside = 0.3;
  for (const int part : {0, 3}) {
    event->covariance.diagonal().segment<3>(part).array() +=
        kAside * kAside * motion.segment<3>(part).squaredNorm();
  }
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

/// That of the newest keyframe, carried over to a frame, and what its own resection adds.
Drift Backend::Impl::drift_of(const Resection& r) const {
  const MapKeyframe& reference = map.keyframes.back();
  Drift drift = reference.drift.seen_from(reference.T_world_camera.inverse() * r.T_world_camera);
  drift.covariance.topLeftCorner<6, 6>() += kObservationsPerFact * r.covariance;
  return drift;
}

/// Whether a pose that was found is good, and if not, why.
void Backend::Impl::judge(double visible, bool odd, PoseEvent* event) const {
  event->state = TrackingState::degraded;
  if (event->inliers < 2 * options.min_inliers) {
    event->reason = "few landmarks are in view";
  } else if (event->inliers < kGoodShare * visible) {
    event->reason = "many landmarks disagree with the pose";
  } else if (odd) {
    event->reason = "the residuals are larger than they were";
  } else if (freedom != IntrinsicsFreedom::all && focal.wrong() > kSurelyWrong) {
    event->reason =
        fmt::format("the calibration does not fit: the images ask for a focal length {:.0f} % {}",
                    100 * std::abs(focal.asked()), focal.asked() > 0 ? "longer" : "shorter");
  } else {
    event->state = TrackingState::tracking;
  }
}

void Backend::Impl::add_tracking(const FrameTracks& tracks, PoseEvent* event) {
  const Sighting seen = sight(tracks);
  ResectSettings settings;
  settings.max_error_px = options.max_error_px;
  settings.huber_px = options.huber_px;
  settings.min_inliers = options.min_inliers;
  settings.seed = options.seed;
  const auto foretold = predict(tracks.frame->time_ns);
  const Resection r =
      resect(map.camera, seen.points,
             foretold ? std::optional(foretold->T_world_camera) : std::nullopt, settings);
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
  const Pose step = pose_of(frames.back()).inverse() * r.T_world_camera;
  judge(visible, doubt.add(segment, r, step, options.max_error_px), event);
  if (tracks.keyframe) {
    insert_keyframe(tracks, outliers, r);
    event->T_world_camera = map.keyframes.back().T_world_camera;
    event->covariance =
        map.keyframes.back().drift.pose_covariance(focal.square()) + doubt.covariance();
    event->covariance *= unexplained(*event);
    return;
  }
  const MapKeyframe& reference = map.keyframes.back();
  const Pose T_keyframe_frame = reference.T_world_camera.inverse() * r.T_world_camera;
  frames.push_back({tracks.frame->id, tracks.frame->time_ns,
                    static_cast<int>(map.keyframes.size()) - 1, T_keyframe_frame});
  event->T_world_camera = r.T_world_camera;
  event->covariance = drift_of(r).pose_covariance(focal.square()) + doubt.covariance();
  event->covariance *= unexplained(*event);
}

void Backend::Impl::insert_keyframe(const FrameTracks& tracks, const std::vector<TrackId>& outliers,
                                    const Resection& r) {
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
  const Drift drift = drift_of(r);
  const int k = map.add_keyframe(tracks.frame, segment, r.T_world_camera, kept);
  map.keyframes.back().drift = drift;  // until the window knows better
  frames.push_back({tracks.frame->id, tracks.frame->time_ns, k, Pose()});
  map.triangulate_tracks(k, options.min_angle_rad, options.max_error_px);
  lap("backend/triangulate");
  adjust_newest();
  learn_focal();
  map.forget_tracks(k - options.window_keyframes);
  rest_on_known_ground(k);
  lap("backend/adjust");
  publish_map();
}

/// The keyframe that left the window long ago rests, if the ground was known before it came.
void Backend::Impl::rest_on_known_ground(int newest) {
  const int long_ago = kRestingWindows * options.window_keyframes;
  const int ended = newest - options.window_keyframes, k = newest - long_ago;
  if (ended >= 0) tie(map, ended, ended - long_ago);
  if (k < 0) return;
  if (const auto host = known_view(map, k, k - long_ago))
    rest(map, k, *host, newest - options.window_keyframes);
}

/// Window adjustment around the newest keyframe.
void Backend::Impl::adjust_newest() {
  // While the intrinsics settle everything moves with them; later they stay, and so does the past.
  const IntrinsicsPolicy policy = intrinsics_policy();
  const int count = intrinsics_settle() || policy.freedom != IntrinsicsFreedom::fixed
                        ? segment_keyframes()
                        : options.window_keyframes;
  if (positions.any()) {
    positions.follow(map, segment);
    lap("backend/positions");
  }
  adjust_window(map, segment_first, count, options, threads, policy);
}

/// So that every segment whose positions are known fits them by one similarity.
void Backend::Impl::straighten_segments() {
  for (int s = 0; s <= newest_segment; ++s) {
    if (positions.place_whole(map, s)) continue;
    move_keyframes(map, frames, positions.straightened(map, s));
    positions.place_whole(map, s);
  }
}

void Backend::Impl::publish_map() { published_map = map.snapshot(++version); }

Backend::Backend(const BackendOptions& options, IntrinsicsOrigin origin, int threads)
    : impl_(std::make_unique<Impl>(
          options, origin,
          threads > 0 ? threads
                      : std::max(1, static_cast<int>(std::thread::hardware_concurrency())))) {
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

bool Backend::finish(const std::stop_token& stop) {
  Impl& b = *impl_;
  if (b.map.keyframes.empty()) return true;
  b.straighten_segments();
  bool whole = true;
  if (b.options.final_adjustment) {
    adjust_all(b.map, b.options, b.threads, b.final_intrinsics_policy(), stop);
    whole = !stop.stop_requested();
    for (int s = 0; s <= b.newest_segment; ++s) b.positions.place_whole(b.map, s);
  }
  b.publish_map();
  return whole;
}

void Backend::add_positions(std::span<const PositionFix> fixes) { impl_->positions.add(fixes); }

std::vector<MapPlacement> Backend::placements() const {
  std::vector<MapPlacement> out;
  for (int s = 0; s <= impl_->newest_segment; ++s) {
    const auto placement = impl_->positions.placement(s);
    out.push_back(placement ? *placement : MapPlacement{});
    if (!placement) out.back().reason = "no positions";
  }
  return out;
}

Trajectory Backend::trajectory() const {
  Trajectory trajectory;
  trajectory.reserve(impl_->frames.size());
  for (const FrameRecord& record : impl_->frames) {
    trajectory.push_back({record.time_ns, impl_->pose_of(record)});
  }
  return trajectory;
}

std::vector<int> Backend::trajectory_segments() const {
  std::vector<int> segments;
  segments.reserve(impl_->frames.size());
  for (const FrameRecord& record : impl_->frames)
    segments.push_back(impl_->map.keyframes[static_cast<std::size_t>(record.keyframe)].segment);
  return segments;
}

std::vector<std::pair<std::string, double>> Backend::last_timings_ms() const {
  return impl_->timings;
}

}  // namespace corvid
