#include "backend/window.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <set>
#include <span>
#include <utility>
#include <vector>

#include "backend/bundle.h"
#include "backend/rest.h"
#include "core/check.h"
#include "core/log.h"
#include "core/stopwatch.h"

namespace corvid {
namespace {

/// A bundle problem made of part of the map, and the way back.
struct Part {
  BundleProblem problem;
  std::vector<int> keyframes;     // of each pose
  std::vector<MapTrack*> tracks;  // of each point
  std::vector<TrackId> ids;       // of each point
};

constexpr std::size_t kMostFixedViews = 6;  ///< of a landmark, in keyframes that do not move

/// Which of a landmark's views count: all in keyframes that move, and of the others, evenly spread,
/// so many that more would hardly say more: a landmark that is found again and again on a long
/// flight would make every adjustment slower than the one before.
std::vector<const KeyframeView*> views_that_count(const MapTrack& track, int first,
                                                  const std::vector<std::uint8_t>& moving) {
  const auto stays = [&](const KeyframeView& v) {
    return v.keyframe >= first && moving[static_cast<std::size_t>(v.keyframe)] == 0;
  };
  const auto fixed =
      static_cast<std::size_t>(std::count_if(track.views.begin(), track.views.end(), stays));
  const std::size_t kept = std::min(fixed, kMostFixedViews);
  std::vector<const KeyframeView*> counted;
  std::size_t i = 0;
  for (const KeyframeView& v : track.views) {
    if (v.keyframe < first) continue;
    if (stays(v)) {
      ++i;
      if (i * kept / fixed == (i - 1) * kept / fixed) continue;
    }
    counted.push_back(&v);
  }
  return counted;
}

/// The landmarks that keyframes marked `moving` see, with their views in keyframes >= first.
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
    part.ids.push_back(id);
    part.problem.points.push_back(track.p_world);
    for (const KeyframeView* v : views_that_count(track, first, moving)) {
      const auto k = static_cast<std::size_t>(v->keyframe);
      if (pose_of[k] < 0) {
        pose_of[k] = static_cast<int>(part.keyframes.size());
        part.keyframes.push_back(v->keyframe);
        part.problem.T_world_camera.push_back(map.keyframes[k].T_world_camera);
        part.problem.fixed.push_back(moving[k] == 0 ? 1 : 0);
      }
      part.problem.observations.push_back({pose_of[k], point, v->pixel, v->sigma_px});
    }
  }
  for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
    const auto& position = map.keyframes[static_cast<std::size_t>(part.keyframes[i])].position;
    if (!position || part.problem.fixed[i] != 0) continue;
    part.problem.positions.push_back(
        {static_cast<int>(i), position->p_world, position->sqrt_information});
  }
  return part;
}

/// The poses whose distance stands for the scale: that of the earliest keyframe, and of the first
/// one that is at least half as far from it as any is. (A camera that only turned first, or stood
/// still, has keyframes in one place, whose distance is nothing but noise.) Empty if all are there.
std::vector<int> scale_pair(const Part& part, std::vector<int> poses) {
  std::sort(poses.begin(), poses.end(), [&](int a, int b) {
    return part.keyframes[static_cast<std::size_t>(a)] <
           part.keyframes[static_cast<std::size_t>(b)];
  });
  if (poses.size() < 2) return {};
  const auto distance = [&](int pose) {
    const auto& T = part.problem.T_world_camera;
    return (T[static_cast<std::size_t>(pose)].translation() -
            T[static_cast<std::size_t>(poses.front())].translation())
        .norm();
  };
  double farthest = 0;
  for (const int pose : poses) farthest = std::max(farthest, distance(pose));
  for (const int pose : poses) {
    if (farthest > 0 && distance(pose) >= 0.5 * farthest) return {poses.front(), pose};
  }
  return {};
}

void write_back(MapData& map, const Part& part, bool camera_changed) {
  for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
    if (part.problem.fixed[i] != 0) continue;
    map.keyframes[static_cast<std::size_t>(part.keyframes[i])].T_world_camera =
        part.problem.T_world_camera[i];
  }
  for (std::size_t i = 0; i < part.tracks.size(); ++i) {
    part.tracks[i]->p_world = part.problem.points[i];
    map.stale_landmarks.insert(chunk_of(part.ids[i]));
  }
  follow_hosts(map);
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

/// Drift of the newest keyframe: that of the newest fixed one whose own is known (or of the first,
/// which has none), and what the views since then leave open.
void estimate_drift(MapData& map, const Part& part, int first, double huber_px) {
  int newest = -1, anchor = -1;  // keyframes
  for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
    const int k = part.keyframes[i];
    newest = std::max(newest, k);
    const bool known = map.keyframes[static_cast<std::size_t>(k)].drift.known;
    if (part.problem.fixed[i] != 0 && (known || k == first)) anchor = std::max(anchor, k);
  }
  if (anchor < 0 || newest <= anchor) return;
  BundleProblem since;
  since.camera = part.problem.camera;
  since.points = part.problem.points;
  std::vector<int> pose_of(part.keyframes.size(), -1);
  int from = -1, to = -1;
  for (const BundleObservation& o : part.problem.observations) {
    const auto i = static_cast<std::size_t>(o.pose);
    const int k = part.keyframes[i];
    if (k < anchor) continue;
    if (pose_of[i] < 0) {
      pose_of[i] = static_cast<int>(since.T_world_camera.size());
      since.T_world_camera.push_back(part.problem.T_world_camera[i]);
      since.fixed.push_back(0);
      if (k == anchor) from = pose_of[i];
      if (k == newest) to = pose_of[i];
    }
    since.observations.push_back({pose_of[i], o.point, o.pixel, o.sigma_px});
  }
  if (from < 0 || to < 0) return;
  const DriftLink link = drift_link(since, from, to, huber_px);
  MapKeyframe& k = map.keyframes[static_cast<std::size_t>(newest)];
  const MapKeyframe& a = map.keyframes[static_cast<std::size_t>(anchor)];
  if (!link.ok) return;
  k.drift = a.drift.seen_from(a.T_world_camera.inverse() * k.T_world_camera);
  k.drift.known = true;
  k.drift.covariance += kObservationsPerFact * link.drift.covariance;
  k.drift.by_focal += link.drift.by_focal;
  k.focal = {link.focal.share, std::sqrt(kObservationsPerFact) * link.focal.sigma};
}

/// Frees more intrinsics in an adjusted problem, where what they explain is beyond doubt: over a
/// plane seen from one side, distortion and a bent ground cannot be told apart.
bool explains_more(BundleProblem& problem, const BundleSettings& settings) {
  constexpr double kLeastRatio = 100, kLeastShare = 0.01;
  const double unknowns = 6.0 * static_cast<double>(problem.T_world_camera.size()) +
                          3.0 * static_cast<double>(problem.points.size());
  const double rows = 2.0 * static_cast<double>(problem.observations.size());
  const SolveResult r = adjust(problem, settings);
  if (r.stopped) return false;
  const double explained = r.initial_cost - r.final_cost;
  // Likelihood ratio of the two models: chi-square with as many degrees of freedom as intrinsics
  // were freed, if errors are independent; they are not quite, hence the margin.
  return r.ok && explained * (rows - unknowns) > kLeastRatio * r.final_cost &&
         explained > kLeastShare * r.final_cost;
}

/// adjust(), with the last freedom of the intrinsics only where explains_more().
bool adjust_part(BundleProblem& problem, const BundleSettings& settings) {
  BundleSettings sure = settings;
  if (settings.freedom == IntrinsicsFreedom::radial) sure.freedom = IntrinsicsFreedom::fixed;
  if (settings.freedom == IntrinsicsFreedom::all) sure.freedom = IntrinsicsFreedom::focal;
  const SolveResult r = adjust(problem, sure);
  if (!r.ok) return false;
  if (r.stopped || sure.freedom == settings.freedom) return true;
  BundleProblem freed = problem;
  if (!explains_more(freed, settings)) return true;
  if (settings.freedom == IntrinsicsFreedom::radial) {
    // A focal length that is wrong looks like distortion, too: then the calibration is no good, and
    // that is for others to say.
    BundleSettings focal = settings;
    focal.freedom = IntrinsicsFreedom::focal;
    if (BundleProblem more = freed; explains_more(more, focal)) return true;
  }
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
  std::vector<int> poses;
  for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
    if (part.keyframes[i] >= first) poses.push_back(static_cast<int>(i));
  }
  const std::vector<int> gauge = scale_pair(part, std::move(poses));
  if (gauge.empty()) return false;
  if (fixed == 0) part.problem.fixed[static_cast<std::size_t>(gauge[0])] = 1;
  if (fixed < 2) part.problem.hold_distance.emplace_back(gauge[0], gauge[1]);

  const bool ok = adjust_part(part.problem, settings_for(options, threads, intrinsics));
  if (ok) {
    write_back(map, part, intrinsics.freedom != IntrinsicsFreedom::fixed);
    estimate_drift(map, part, first, options.huber_px);
  }
  drop_outliers(map, part, options);
  return ok;
}

namespace {

std::size_t count_views(const MapData& map) {
  std::size_t views = 0;
  for (const auto& [id, track] : map.tracks) views += track.landmark ? track.views.size() : 0;
  return views;
}

/// Adjusts a part of one segment; what it shares landmarks with stays. The segment's first keyframe
/// stays, too, unless positions hold the segment.
void adjust_piece(MapData& map, std::span<const int> keyframes, int first, bool placed,
                  const BackendOptions& options, const BundleSettings& settings) {
  std::vector<std::uint8_t> moving(map.keyframes.size(), 0);
  for (const int k : keyframes) moving[static_cast<std::size_t>(k)] = k == first && !placed ? 0 : 1;
  Part part = collect(map, moving, 0);
  std::vector<int> poses(part.keyframes.size());
  std::iota(poses.begin(), poses.end(), 0);
  const auto fixed = std::count(part.problem.fixed.begin(), part.problem.fixed.end(), 1);
  if (fixed < 2 && !placed) {
    const std::vector<int> gauge = scale_pair(part, std::move(poses));
    if (gauge.empty()) return;
    if (fixed == 0) part.problem.fixed[static_cast<std::size_t>(gauge[0])] = 1;
    part.problem.hold_distance.emplace_back(gauge[0], gauge[1]);
  }
  if (adjust(part.problem, settings).ok) write_back(map, part, false);
  drop_outliers(map, part, options);
}

/// Every segment piece by piece, each twice as long as the step to the next one.
void adjust_in_pieces(MapData& map, const BackendOptions& options, const BundleSettings& settings) {
  const auto most = static_cast<std::size_t>(options.adjustment_views);
  std::map<int, std::vector<int>> segments;
  std::set<int> placed;
  for (std::size_t k = 0; k < map.keyframes.size(); ++k) {
    segments[map.keyframes[k].segment].push_back(static_cast<int>(k));
    if (map.keyframes[k].position) placed.insert(map.keyframes[k].segment);
  }
  std::size_t done = 0;
  for (const auto& [segment, keyframes] : segments) {
    std::size_t begin = 0, end = 0, half = 0;
    while (end < keyframes.size() && !settings.stop.stop_requested()) {
      std::size_t views = 0;
      for (end = begin; end < keyframes.size() && views < most; ++end) {
        views += map.keyframes[static_cast<std::size_t>(keyframes[end])].tracks.size();
        if (2 * views < most) half = end + 1;
      }
      adjust_piece(map, std::span(keyframes).subspan(begin, end - begin), keyframes.front(),
                   placed.contains(segment), options, settings);
      log().info("adjustment: {} of {} keyframes", done + end, map.keyframes.size());
      begin = std::max(begin + 1, half);
    }
    done += keyframes.size();
  }
}

}  // namespace

bool adjust_all(MapData& map, const BackendOptions& options, int threads,
                const IntrinsicsPolicy& intrinsics, const std::stop_token& stop) {
  constexpr int kRounds = 2, kIterations = 30;
  if (count_views(map) > static_cast<std::size_t>(options.adjustment_views)) {
    BundleSettings settings = settings_for(options, threads, intrinsics);
    settings.freedom = IntrinsicsFreedom::fixed;
    settings.stop = stop;
    adjust_in_pieces(map, options, settings);
    return true;
  }
  constexpr double kTellEvery_ms = 1000;
  Stopwatch watch;
  double since_told_ms = 0;
  for (int round = 0; round < kRounds && !stop.stop_requested(); ++round) {
    Part part = collect(map, std::vector<std::uint8_t>(map.keyframes.size(), 1), 0);
    if (part.keyframes.size() < 2) return false;
    // Gauge of every segment: its positions, or else its first keyframe and a distance from it.
    std::set<int> placed;
    for (const MapKeyframe& k : map.keyframes) {
      if (k.position) placed.insert(k.segment);
    }
    std::map<int, std::vector<int>> segments;
    for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
      const auto k = static_cast<std::size_t>(part.keyframes[i]);
      segments[map.keyframes[k].segment].push_back(static_cast<int>(i));
    }
    for (const auto& [segment, poses] : segments) {
      if (placed.count(segment) != 0) continue;
      const int first = *std::min_element(poses.begin(), poses.end(), [&](int a, int b) {
        return part.keyframes[static_cast<std::size_t>(a)] <
               part.keyframes[static_cast<std::size_t>(b)];
      });
      part.problem.fixed[static_cast<std::size_t>(first)] = 1;
      if (const auto gauge = scale_pair(part, poses); !gauge.empty()) {
        part.problem.hold_distance.emplace_back(gauge[0], gauge[1]);
      }
    }
    BundleSettings settings = settings_for(options, threads, intrinsics);
    settings.max_iterations = kIterations;
    settings.stop = stop;
    settings.on_iteration = [&](int iteration, double cost) {
      since_told_ms += watch.lap_ms();
      if (since_told_ms < kTellEvery_ms) return;
      since_told_ms = 0;
      log().info("adjustment: round {} of {}, iteration {}, {} keyframes, cost {:.6g}", round + 1,
                 kRounds, iteration, part.keyframes.size(), cost);
    };
    if (!adjust_part(part.problem, settings)) return false;
    write_back(map, part, intrinsics.freedom != IntrinsicsFreedom::fixed);
    drop_outliers(map, part, options);
  }
  return true;
}

}  // namespace corvid
