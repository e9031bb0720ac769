#include "backend/window.h"

#include <algorithm>

#include "backend/bundle.h"
#include "core/check.h"

namespace corvid {
namespace {

/// A bundle problem made of part of the map, and the way back.
struct Part {
  BundleProblem problem;
  std::vector<int> keyframes;     // of each pose
  std::vector<MapTrack*> tracks;  // of each point
};

/// The landmarks that keyframes marked `moving` see, with all their views in keyframes >= first.
Part collect(MapData& map, const std::vector<std::uint8_t>& moving, int first) {
  Part part;
  part.problem.camera = map.camera;
  std::vector<int> pose_of(map.keyframes.size(), -1);
  std::vector<TrackId> ids;
  for (std::size_t k = 0; k < moving.size(); ++k) {
    if (moving[k] == 0) continue;
    const auto& tracks = map.keyframes[k].tracks;
    ids.insert(ids.end(), tracks.begin(), tracks.end());
  }
  std::sort(ids.begin(), ids.end());
  ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
  for (const TrackId id : ids) {
    const auto it = map.tracks.find(id);
    if (it == map.tracks.end() || !it->second.landmark) continue;
    MapTrack& track = it->second;
    const int point = static_cast<int>(part.tracks.size());
    part.tracks.push_back(&track);
    part.problem.points.push_back(track.p_world);
    for (const KeyframeView& v : track.views) {
      if (v.keyframe < first) continue;
      const auto k = static_cast<std::size_t>(v.keyframe);
      if (pose_of[k] < 0) {
        pose_of[k] = static_cast<int>(part.keyframes.size());
        part.keyframes.push_back(v.keyframe);
        part.problem.T_world_camera.push_back(map.keyframes[k].T_world_camera);
        part.problem.fixed.push_back(moving[k] == 0 ? 1 : 0);
      }
      part.problem.observations.push_back({pose_of[k], point, v.pixel, v.sigma_px});
    }
  }
  return part;
}

/// Poses of the problem that stand for the earliest two keyframes >= first, in that order.
std::vector<int> earliest_two(const Part& part, int first) {
  std::vector<std::pair<int, int>> order;
  for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
    if (part.keyframes[i] >= first) order.emplace_back(part.keyframes[i], static_cast<int>(i));
  }
  std::sort(order.begin(), order.end());
  std::vector<int> poses;
  for (std::size_t i = 0; i < order.size() && i < 2; ++i) poses.push_back(order[i].second);
  return poses;
}

void write_back(MapData& map, const Part& part, bool camera_changed) {
  for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
    if (part.problem.fixed[i] != 0) continue;
    MapKeyframe& keyframe = map.keyframes[static_cast<std::size_t>(part.keyframes[i])];
    keyframe.T_world_camera = part.problem.T_world_camera[i];
    keyframe.published = nullptr;
  }
  for (std::size_t i = 0; i < part.tracks.size(); ++i) {
    part.tracks[i]->p_world = part.problem.points[i];
  }
  if (camera_changed) map.set_camera(part.problem.camera);
}

/// Widest angle between the first or the last ray and any other.
double widest_angle(const MapData& map, const MapTrack& track) {
  double widest = 0;
  const auto ray = [&](const KeyframeView& v) {
    return Eigen::Vector3d(
        track.p_world -
        map.keyframes[static_cast<std::size_t>(v.keyframe)].T_world_camera.translation());
  };
  const Eigen::Vector3d first = ray(track.views.front()), last = ray(track.views.back());
  for (const KeyframeView& v : track.views) {
    const Eigen::Vector3d d = ray(v);
    widest = std::max({widest, angle_between(first, d), angle_between(last, d)});
  }
  return widest;
}

/// Drops what does not fit after an adjustment.
void drop_outliers(MapData& map, const Part& part, const BackendOptions& options) {
  const double max2 = options.max_error_px * options.max_error_px;
  const int newest = static_cast<int>(map.keyframes.size()) - 1;
  for (MapTrack* const track : part.tracks) {
    for (std::size_t i = track->views.size(); i-- > 0;) {
      const KeyframeView& v = track->views[i];
      const Pose& T = map.keyframes[static_cast<std::size_t>(v.keyframe)].T_world_camera;
      const auto pixel = map.camera.project(T.inverse() * track->p_world);
      if (pixel && (*pixel - v.pixel).squaredNorm() < max2) continue;
      if (v.keyframe == newest) track->dead = true;
      map.drop_view(*track, i);
    }
    track->max_ray_angle_rad = track->views.size() < 2 ? 0 : widest_angle(map, *track);
    // Two views of a track that went wrong prove nothing. The angle has some hysteresis: one just
    // above the gate may shrink a little as poses move.
    const std::size_t least = track->dead ? 3 : 2;
    if (track->views.size() < least || track->max_ray_angle_rad < 0.7 * options.min_angle_rad)
      map.drop_landmark(*track);
  }
}

BundleSettings settings_for(const BackendOptions& options, int threads,
                            const IntrinsicsPolicy& intrinsics) {
  BundleSettings settings;
  settings.huber_px = options.huber_px;
  settings.max_iterations = options.max_iterations;
  settings.threads = threads;
  settings.freedom = intrinsics.freedom;
  settings.intrinsics_prior = intrinsics.prior;
  return settings;
}

/// Covariance of the newest keyframe: what the window adds to that of the newest fixed keyframe.
void estimate_covariance(MapData& map, const Part& part, double huber_px) {
  int newest = -1, anchor = -1;
  for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
    const int pose = static_cast<int>(i);
    int& best = part.problem.fixed[i] != 0 ? anchor : newest;
    if (best < 0 || part.keyframes[i] > part.keyframes[static_cast<std::size_t>(best)]) {
      best = pose;
    }
  }
  if (newest < 0 || anchor < 0) return;
  const auto keyframe = [&](int pose) -> MapKeyframe& {
    return map.keyframes[static_cast<std::size_t>(part.keyframes[static_cast<std::size_t>(pose)])];
  };
  MapKeyframe& k = keyframe(newest);
  const MapKeyframe& a = keyframe(anchor);
  // T_anchor exp(d) T_anchor_k = T_k exp(Ad(T_k_anchor) d).
  const Matrix6d Ad = (k.T_world_camera.inverse() * a.T_world_camera).adjoint();
  k.covariance =
      pose_covariance(part.problem, newest, huber_px) + Ad * a.covariance * Ad.transpose();
}

/// adjust(), with the distortion of a calibrated camera left alone unless what it explains is
/// beyond doubt: over a plane seen from one side, distortion and a bent ground cannot be told
/// apart.
bool adjust_part(BundleProblem& problem, const BundleSettings& settings) {
  if (settings.freedom != IntrinsicsFreedom::distortion) return adjust(problem, settings).ok;
  constexpr double kLeastRatio = 100, kLeastShare = 0.01;
  BundleSettings fixed = settings;
  fixed.freedom = IntrinsicsFreedom::fixed;
  if (!adjust(problem, fixed).ok) return false;
  BundleProblem freed = problem;
  const BundleResult r = adjust(freed, settings);
  const double unknowns = 6.0 * static_cast<double>(problem.T_world_camera.size()) +
                          3.0 * static_cast<double>(problem.points.size());
  const double rows = 2.0 * static_cast<double>(problem.observations.size());
  const double explained = r.initial_cost - r.final_cost;
  // Likelihood ratio of the two models: chi-square with 2 degrees of freedom if the distortion is
  // right already and errors are independent; they are not quite, hence the margin.
  if (r.ok && explained * (rows - unknowns) > kLeastRatio * r.final_cost &&
      explained > kLeastShare * r.final_cost)
    problem = std::move(freed);
  return true;
}

}  // namespace

bool adjust_window(MapData& map, int first, int count, const BackendOptions& options, int threads,
                   const IntrinsicsPolicy& intrinsics) {
  const int size = static_cast<int>(map.keyframes.size());
  CORVID_CHECK(first >= 0 && first < size, "no such keyframe");
  std::vector<std::uint8_t> moving(map.keyframes.size(), 0);
  const int segment = map.keyframes.back().segment;
  for (int k = size - 1; k >= first && count > 0; --k) {
    if (map.keyframes[static_cast<std::size_t>(k)].segment != segment) continue;
    moving[static_cast<std::size_t>(k)] = 1;
    --count;
  }
  Part part = collect(map, moving, first);
  int fixed = 0;
  for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
    if (part.keyframes[i] == first) part.problem.fixed[i] = 1;
    fixed += part.problem.fixed[i];
  }
  const std::vector<int> gauge = earliest_two(part, first);
  if (gauge.size() < 2) return false;
  if (fixed == 0) part.problem.fixed[static_cast<std::size_t>(gauge[0])] = 1;
  if (fixed < 2) part.problem.hold_distance.emplace_back(gauge[0], gauge[1]);

  const bool ok = adjust_part(part.problem, settings_for(options, threads, intrinsics));
  if (ok) {
    write_back(map, part, intrinsics.freedom != IntrinsicsFreedom::fixed);
    estimate_covariance(map, part, options.huber_px);
  }
  drop_outliers(map, part, options);
  return ok;
}

bool adjust_all(MapData& map, const BackendOptions& options, int threads,
                const IntrinsicsPolicy& intrinsics) {
  constexpr int kRounds = 2, kIterations = 30;
  for (int round = 0; round < kRounds; ++round) {
    Part part = collect(map, std::vector<std::uint8_t>(map.keyframes.size(), 1), 0);
    if (part.keyframes.size() < 2) return false;
    // Gauge of every segment: its first keyframe, and the distance to its second. Segments that
    // were joined may have others between them.
    std::vector<std::pair<int, int>> order;
    for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
      order.emplace_back(part.keyframes[i], static_cast<int>(i));
    }
    const auto segment_of = [&](int k) {
      return map.keyframes[static_cast<std::size_t>(k)].segment;
    };
    std::sort(order.begin(), order.end(), [&](const auto& a, const auto& b) {
      return std::pair(segment_of(a.first), a.first) < std::pair(segment_of(b.first), b.first);
    });
    const auto segment = [&](std::size_t i) { return segment_of(order[i].first); };
    for (std::size_t i = 0; i < order.size(); ++i) {
      if (i > 0 && segment(i) == segment(i - 1)) continue;
      part.problem.fixed[static_cast<std::size_t>(order[i].second)] = 1;
      if (i + 1 < order.size() && segment(i + 1) == segment(i)) {
        part.problem.hold_distance.emplace_back(order[i].second, order[i + 1].second);
      }
    }
    BundleSettings settings = settings_for(options, threads, intrinsics);
    settings.max_iterations = kIterations;
    if (!adjust_part(part.problem, settings)) return false;
    write_back(map, part, intrinsics.freedom != IntrinsicsFreedom::fixed);
    drop_outliers(map, part, options);
  }
  return true;
}

}  // namespace corvid
