#include "backend/backend_impl.h"

#include <algorithm>

#include "core/median.h"

namespace corvid {

/// The newest frames of the segment whose pose was measured, newest first.
std::vector<const FrameRecord*> Backend::Impl::newest_measured(std::size_t count) const {
  std::vector<const FrameRecord*> out;
  for (std::size_t i = frames.size(); i > segment_first_frame && out.size() < count; --i) {
    if (!frames[i - 1].foretold) out.push_back(&frames[i - 1]);
  }
  return out;
}

std::optional<Backend::Impl::Foretold> Backend::Impl::predict(std::int64_t time_ns) const {
  const auto measured = newest_measured(2);
  if (measured.empty()) return std::nullopt;
  const Pose newest = pose_of(*measured[0]);
  if (measured.size() < 2) return Foretold{newest, {}};
  const auto step_ns = static_cast<double>(measured[0]->time_ns - measured[1]->time_ns);
  const auto ahead_ns = static_cast<double>(time_ns - measured[0]->time_ns);
  if (!(step_ns > 0)) return Foretold{newest, {}};
  const Vector6d motion = (pose_of(*measured[1]).inverse() * newest).log() * (ahead_ns / step_ns);
  constexpr double kMostSteps = 3;
  return Foretold{ahead_ns > kMostSteps * step_ns ? newest : newest * Pose::exp(motion), motion};
}

/// A step ten times as fast as the last ones, that not even most landmarks agree with.
bool Backend::Impl::jumps(const Resection& r, std::size_t points, std::int64_t time_ns) const {
  constexpr std::size_t kSteps = 10;
  constexpr double kTimesFaster = 10, kMostShare = 0.6;
  if (r.inliers >= kMostShare * static_cast<double>(points)) return false;
  const auto seconds = [](std::int64_t ns) { return 1e-9 * static_cast<double>(ns); };
  std::vector<double> speeds;
  const auto measured = newest_measured(kSteps);
  for (std::size_t i = 1; i < measured.size(); ++i) {
    const double dt = seconds(measured[i - 1]->time_ns - measured[i]->time_ns);
    const double step =
        (pose_of(*measured[i - 1]).translation() - pose_of(*measured[i]).translation()).norm();
    if (dt > 0) speeds.push_back(step / dt);
  }
  if (speeds.size() < 3) return false;
  const double dt = seconds(time_ns - measured[0]->time_ns);
  if (!(dt > 0)) return false;
  const double speed =
      (r.T_world_camera.translation() - pose_of(*measured[0]).translation()).norm() / dt;
  // A hovering camera may start to move: speeds far below one scene depth per 10 s are no jump.
  return speed > kTimesFaster * std::max(upper_median(std::move(speeds)), 0.01 * median_depth);
}

void Backend::Impl::publish_motion(std::span<const TrackObservation> observations) {
  auto motion = std::make_shared<MotionState>();
  if (mode == Mode::tracking && lost_frames == 0) {
    const auto measured = newest_measured(2);
    for (std::size_t i = measured.size(); i-- > 0;) {
      motion->recent.push_back({measured[i]->time_ns, pose_of(*measured[i])});
    }
  }
  if (mode == Mode::tracking) {
    const std::size_t kept = static_cast<std::size_t>(2 * options.window_keyframes);
    const std::size_t all = map.keyframes.size(), first = static_cast<std::size_t>(segment_first);
    for (std::size_t k = std::max(first, all > kept ? all - kept : 0); k < all; ++k) {
      if (map.keyframes[k].segment != segment) continue;  // in another world
      motion->keyframes.emplace_back(map.keyframes[k].frame->id, map.keyframes[k].T_world_camera);
    }
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
