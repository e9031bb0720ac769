#include "backend/backend_impl.h"

#include <algorithm>

#include "core/median.h"

namespace corvid {

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

}  // namespace corvid
