#include "backend/backend.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <map>
#include <optional>
#include <span>
#include <thread>

#include "backend/map_data.h"
#include "backend/map_positions.h"
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

constexpr int kMaxLostFrames = 15;     ///< then a new segment starts
constexpr double kMinShare = 0.2;      ///< of the landmarks must agree with a pose
constexpr double kGoodShare = 0.4;     ///< fewer: degraded
constexpr double kSurelyWrong = 0.99;  ///< probability that makes a calibration a wrong one
constexpr int kMaxStrikes = 3;         ///< frames in a row in which a track may disagree
constexpr int kIntrinsicsFrom = 6;     ///< keyframes before intrinsics are refined
constexpr int kIntrinsicsUntil = 30;   ///< keyframes after which windows leave them alone
/// Keyframes at which the distortion alone is refined.
constexpr std::array kDistortionAt{6, 9, 13, 20, 30};
constexpr int kUntrackedStride = 5;      ///< of the frames that are looked for while lost
constexpr std::size_t kMostWaiting = 8;  ///< of them whose answer may still come

/// Factor on the covariance of a pose that rests on a small part of what is tracked: when the world
/// agrees, 70 % and more do.
double unexplained(const PoseEvent& event) {
  constexpr double kUsualShare = 0.7;
  const double times = kUsualShare * event.tracks / std::max(1, event.inliers);
  return std::max(1.0, times * times);
}

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
  void add_stale(const FrameTracks& tracks, PoseEvent* event);
  void add_lost(const FrameTracks& tracks, std::string reason, PoseEvent* event);
  void judge(double visible, bool odd, PoseEvent* event) const;
  [[nodiscard]] bool residuals_are_odd(double mse_px2);
  void doubt_motion(bool odd, const Pose& T_world_camera);
  void learn_focal();
  void insert_keyframe(const FrameTracks& tracks, const std::vector<TrackId>& outliers,
                       const Resection& r);
  [[nodiscard]] Drift drift_of(const Resection& r) const;
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
  void straighten_segments();
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
  MapPositions positions{options};
  int segment = 0, segment_first = 0;
  int newest_segment = 0;  ///< highest number given so far
  std::vector<FrameRecord> frames;
  std::size_t segment_first_frame = 0;  ///< in `frames`
  FramePtr newest_frame;
  int odd_frames = 0;                                       ///< in a row
  Eigen::Vector2d recent_motion = Eigen::Vector2d::Zero();  ///< in them [map units, rad]
  /// Such motion since a segment's start, by segment.
  std::map<int, Eigen::Vector2d> doubted_motion{{0, Eigen::Vector2d::Zero()}};
  std::deque<double> residuals;  ///< mean squares of the segment's last frames [px^2]
  int lost_frames = 0;
  FocalBelief focal{true};
  Camera focal_camera;      ///< with which `focal` was estimated
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
  event.segment = segment;
  event.placement = positions.placement(segment);
  if (event.placement) event.scale = event.placement->scale;
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
  bool changed = false;
  if (place.ok && in_map != map.keyframes.rend()) {
    const int k = static_cast<int>(map.keyframes.rend() - in_map) - 1;
    const int segment_of_query = map.keyframes[static_cast<std::size_t>(k)].segment;
    const PlaceOutcome outcome = recognise_keyframe(map, frames, fused, k, place, options, threads);
    refusal = outcome.reason;
    using Kind = PlaceOutcome::Kind;
    changed = outcome.kind != Kind::refused;
    places.connections += outcome.kind == Kind::connected ? 1 : 0;
    places.loops += outcome.kind == Kind::loop ? 1 : 0;
    places.merges += outcome.kind == Kind::merge ? 1 : 0;
    if (outcome.kind == Kind::merge) {
      positions.forget_segment(outcome.from);
      doubted_motion[outcome.to] +=
          Eigen::Vector2d(outcome.scale, 1).cwiseProduct(doubted_motion[outcome.from]);
      doubted_motion.erase(outcome.from);
    }
    const bool jumped = (outcome.kind == Kind::loop && segment_of_query == segment) ||
                        (outcome.kind == Kind::merge && outcome.from == segment);
    if (jumped) {
      if (outcome.kind == Kind::merge) enter_segment(outcome.to);
      median_depth *= outcome.scale;
      recent_motion.x() *= outcome.scale;
      residuals.clear();
      odd_frames = 0;
      ++resets;
    }
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
  residuals.clear();
  odd_frames = 0;
  doubted_motion[segment].setZero();
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

/// A picture that is the one before to the last bit, noise included, shows an earlier moment: the
/// camera's driver has repeated it. The pose is foretold from the motion before.
void Backend::Impl::add_stale(const FrameTracks& tracks, PoseEvent* event) {
  event->state = TrackingState::degraded;
  event->reason = "the picture is the same as the one before: the pose is foretold";
  event->keyframe = false;
  const Pose newest = pose_of(frames.back());
  const Pose foretold = predict(tracks.frame->time_ns).value_or(newest);
  const MapKeyframe& reference = map.keyframes.back();
  const Pose T_keyframe_frame = reference.T_world_camera.inverse() * foretold;
  frames.push_back({tracks.frame->id, tracks.frame->time_ns,
                    static_cast<int>(map.keyframes.size()) - 1, T_keyframe_frame});
  event->T_world_camera = foretold;
  // The camera may as well have stopped, or gone twice as fast.
  const Vector6d step = (newest.inverse() * foretold).log();
  event->covariance = reference.drift.seen_from(T_keyframe_frame).pose_covariance(focal.square()) +
                      step * step.transpose();
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

/// Whether residuals are larger than those of the last frames, and large for an inlier. Then points
/// and pose do not fit each other: something moves, or tracks slip.
bool Backend::Impl::residuals_are_odd(double mse_px2) {
  constexpr std::size_t kFrames = 40, kLeast = 10;
  constexpr double kTimes = 2, kShareOfLargest = 0.3;
  const double large_px = kShareOfLargest * options.max_error_px;
  const bool odd =
      residuals.size() >= kLeast && mse_px2 > large_px * large_px &&
      mse_px2 > kTimes * upper_median(std::vector<double>(residuals.begin(), residuals.end()));
  if (!odd) residuals.push_back(mse_px2);
  if (residuals.size() > kFrames) residuals.pop_front();
  return odd;
}

/// What the camera does while residuals are odd for some time may be what something else does: it
/// counts as unknown, for as long as the segment lasts.
void Backend::Impl::doubt_motion(bool odd, const Pose& T_world_camera) {
  constexpr int kLeast = 3;
  if (!odd) {
    odd_frames = 0;
    return;
  }
  const Vector6d step = (pose_of(frames.back()).inverse() * T_world_camera).log();
  const Eigen::Vector2d moved(step.head<3>().norm(), step.tail<3>().norm());
  recent_motion = odd_frames == 0 ? moved : Eigen::Vector2d(recent_motion + moved);
  ++odd_frames;
  if (odd_frames == kLeast) doubted_motion[segment] += recent_motion;
  if (odd_frames > kLeast) doubted_motion[segment] += moved;
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
  const bool odd = residuals_are_odd(r.mse_px2);
  judge(visible, odd, event);
  // What makes residuals larger than they were is no noise: all observations are worth one.
  doubt_motion(odd, r.T_world_camera);
  Matrix6d doubt = odd ? Matrix6d(r.inliers * r.covariance) : Matrix6d::Zero();
  const Eigen::Vector2d& doubted = doubted_motion[segment];
  doubt.diagonal().head<3>().array() += doubted.x() * doubted.x();
  doubt.diagonal().tail<3>().array() += doubted.y() * doubted.y();
  if (tracks.keyframe) {
    insert_keyframe(tracks, outliers, r);
    event->T_world_camera = map.keyframes.back().T_world_camera;
    event->covariance = map.keyframes.back().drift.pose_covariance(focal.square()) + doubt;
    event->covariance *= unexplained(*event);
    return;
  }
  const MapKeyframe& reference = map.keyframes.back();
  const Pose T_keyframe_frame = reference.T_world_camera.inverse() * r.T_world_camera;
  frames.push_back({tracks.frame->id, tracks.frame->time_ns,
                    static_cast<int>(map.keyframes.size()) - 1, T_keyframe_frame});
  event->T_world_camera = r.T_world_camera;
  event->covariance = drift_of(r).pose_covariance(focal.square()) + doubt;
  event->covariance *= unexplained(*event);
}

/// For the adjustment after a new keyframe, while the intrinsics settle.
IntrinsicsPolicy Backend::Impl::intrinsics_policy() const {
  IntrinsicsPolicy policy;
  policy.prior = prior;
  const int n = segment_keyframes();
  if (freedom == IntrinsicsFreedom::fixed || n < kIntrinsicsFrom || n > kIntrinsicsUntil)
    return policy;
  if (freedom == IntrinsicsFreedom::radial) {
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
  if (wide_enough(std::move(angles))) policy.freedom = IntrinsicsFreedom::focal;
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
  if (freedom == IntrinsicsFreedom::radial || wide_enough(std::move(angles)))
    policy.freedom = freedom;
  return policy;
}

/// Intrinsics and a flat fan of rays cannot be told apart.
bool Backend::Impl::wide_enough(std::vector<double> ray_angles_rad) const {
  return upper_median(std::move(ray_angles_rad)) > 2 * options.start_min_parallax_rad;
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
  positions.follow(map, segment);
  lap("backend/positions");
  adjust_window(map, segment_first, count, options, threads, policy);
}

void Backend::Impl::learn_focal() {
  // The estimates were made with another camera.
  if (freedom == IntrinsicsFreedom::all || map.camera.distortion != focal_camera.distortion)
    focal.clear();
  focal_camera = map.camera;
  focal.add(map.keyframes.back().focal, std::min(options.window_keyframes, segment_keyframes()));
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
  residuals.clear();
  odd_frames = 0;
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

/// So that every segment whose positions are known fits them by one similarity.
void Backend::Impl::straighten_segments() {
  for (int s = 0; s <= newest_segment; ++s) {
    if (positions.place_whole(map, s)) continue;
    const std::vector<Sim3> moves = positions.straighten(map, s);
    for (FrameRecord& record : frames) {
      const Pose& T = record.T_keyframe_frame;
      const double scale = moves[static_cast<std::size_t>(record.keyframe)].scale();
      record.T_keyframe_frame = Pose(T.rotation(), scale * T.translation());
    }
    positions.place_whole(map, s);
  }
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
  if (b.map.keyframes.empty()) return;
  b.straighten_segments();
  if (!b.options.final_adjustment) return b.publish_map();
  adjust_all(b.map, b.options, b.threads, b.final_intrinsics_policy());
  for (int s = 0; s <= b.newest_segment; ++s) b.positions.place_whole(b.map, s);
  b.publish_map();
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

std::vector<std::pair<std::string, double>> Backend::last_timings_ms() const {
  return impl_->timings;
}

}  // namespace corvid
