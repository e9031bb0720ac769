#include "backend/start.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "backend/resect.h"
#include "backend/window.h"
#include "core/check.h"

namespace corvid {
namespace {

constexpr int kMaxKeyframes = 10;
constexpr int kLeastFrames = 6;  ///< of a video between the pair: two views agree with too much
constexpr double kMostOutliers = 0.2;    ///< of the points in the frames held
constexpr std::size_t kMaxFrames = 600;  ///< half a minute at 20 Hz; about 20 MB of tracks

ResectSettings resect_settings(const BackendOptions& options) {
  ResectSettings settings;
  settings.max_error_px = options.max_error_px;
  settings.huber_px = options.huber_px;
  settings.min_inliers = options.min_inliers;
  settings.seed = options.seed;
  return settings;
}

}  // namespace

void Starter::hold(const FrameTracks& tracks) {
  const bool keyframe = tracks.keyframe || held_.empty();
  held_.push_back({tracks.frame->id, tracks.frame->time_ns, keyframe,
                   keyframe ? tracks.frame : nullptr, tracks.observations});
  const auto keyframes =
      std::count_if(held_.begin(), held_.end(), [](const Held& h) { return h.keyframe; });
  if (keyframes > kMaxKeyframes) {  // the oldest one goes, with the frames that follow it
    do {
      held_.pop_front();
    } while (!held_.front().keyframe);
  }
  if (held_.size() > kMaxFrames) {
    const auto oldest =
        std::find_if(held_.begin(), held_.end(), [](const Held& h) { return !h.keyframe; });
    if (oldest != held_.end()) held_.erase(oldest);
  }
}

std::optional<Starter::Pair> Starter::best_pair(const Camera& camera,
                                                const BackendOptions& options) {
  const Held& newest = held_.back();
  const bool video =
      std::any_of(held_.begin(), held_.end(), [](const Held& h) { return !h.keyframe; });
  reason_ = "waiting for a second keyframe";
  std::vector<Pair> accepted;
  double most_explained = 0;
  for (std::size_t h = 0; h + 1 < held_.size(); ++h) {
    if (!held_[h].keyframe) continue;
    // Two views near in time agree with nearly any motion: a video has more to say.
    if (video && held_.size() - h < kLeastFrames) continue;
    Pair pair;
    pair.first = h;
    std::vector<PixelPair> pixels;
    const auto& older = held_[h].observations;
    auto o = older.begin();
    for (const TrackObservation& n : newest.observations) {
      while (o != older.end() && o->track < n.track) ++o;
      if (o == older.end()) break;
      if (o->track != n.track || !usable_ray(camera, *o) || !usable_ray(camera, n)) continue;
      pixels.push_back({o->pixel, n.pixel, std::max(floored_sigma_px(*o), floored_sigma_px(n))});
      pair.tracks.push_back(n.track);
    }
    pair.two_view = two_view(camera, pixels, options);
    if (!pair.two_view.accepted) {
      reason_ = pair.two_view.reason;
      continue;
    }
    most_explained = std::max(most_explained, pair.two_view.explained);
    accepted.push_back(std::move(pair));
  }
  // A wrong motion can have wide angles, but it explains less: points and parallax decide only
  // among the pairs that are explained nearly as well as the best one.
  std::optional<Pair> best;
  double best_score = 0;
  for (Pair& pair : accepted) {
    if (pair.two_view.explained < 0.9 * most_explained) continue;
    const TwoViewMotion& motion = pair.two_view.motion;
    const double parallax =
        std::min(motion.median_parallax_rad / options.start_min_parallax_rad, 3.0);
    const double score = parallax * static_cast<double>(motion.index.size());
    if (score <= best_score) continue;
    best_score = score;
    best = std::move(pair);
  }
  return best;
}

std::optional<StartedMap> Starter::build(const Camera& camera, int segment,
                                         const Pose& T_world_first, double median_depth,
                                         const BackendOptions& options, int threads,
                                         const Pair& pair, const TwoViewMotion& motion,
                                         Disagreement* disagreement) const {
  std::vector<double> depths;
  for (const Eigen::Vector3d& p : motion.p_a) depths.push_back(p.norm());
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  const double scale = median_depth / *middle;

  std::map<TrackId, Eigen::Vector3d> points;
  for (std::size_t i = 0; i < motion.index.size(); ++i) {
    points.emplace(pair.tracks[static_cast<std::size_t>(motion.index[i])],
                   T_world_first * (scale * motion.p_a[i]));
  }
  const Pose T_first_newest(motion.T_a_b.rotation(), scale * motion.T_a_b.translation());
  const double span = static_cast<double>(held_.size() - 1 - pair.first);
  const ResectSettings settings = resect_settings(options);
  int judges = 0;
  const auto locate = [&](std::size_t h, const auto& point_of) {
    std::vector<PointView> views;
    for (const TrackObservation& o : held_[h].observations) {
      const Eigen::Vector3d* const p = point_of(o.track);
      if (p != nullptr && o.pixel.allFinite()) views.push_back({*p, o.pixel, floored_sigma_px(o)});
    }
    const double share =
        std::max(0.0, (static_cast<double>(h) - static_cast<double>(pair.first)) / span);
    const Pose guess = T_world_first * Pose::exp(share * T_first_newest.log());
    Resection r = resect(camera, views, guess, settings);
    // What the frame says about the hypothesis: its mean squared error, outliers at the limit.
    const double max2 = options.max_error_px * options.max_error_px;
    const auto n = static_cast<double>(views.size());
    if (n > 0) {
      disagreement->cost_px2 += (r.inliers * r.mse_px2 + (n - r.inliers) * max2) / n;
      disagreement->outliers += (n - r.inliers) / n;
      ++judges;
    }
    return r;
  };
  const auto start_point = [&](TrackId id) -> const Eigen::Vector3d* {
    const auto it = points.find(id);
    return it != points.end() ? &it->second : nullptr;
  };

  StartedMap started;
  MapData& map = started.map;
  map.camera = camera;
  *disagreement = {};
  std::vector<int> keyframe_of(held_.size(), -1);
  for (std::size_t h = 0; h < held_.size(); ++h) {
    if (!held_[h].keyframe) continue;
    const bool given = h == pair.first || h + 1 == held_.size();
    const Resection r = locate(h, start_point);
    if (!given && !r.ok) continue;
    const Pose T = h == pair.first ? T_world_first
                   : given         ? T_world_first * T_first_newest
                                   : r.T_world_camera;
    keyframe_of[h] = map.add_keyframe(held_[h].frame, segment, T, held_[h].observations);
  }
  for (const auto& [id, p] : points) {
    MapTrack& track = map.tracks[id];
    if (track.views.size() < 2) continue;
    Triangulation point;
    point.status = TriangulationStatus::ok;
    point.p_world = p;
    point.max_ray_angle_rad = options.min_angle_rad;
    map.make_landmark(track, point);
  }
  const int keyframes = static_cast<int>(map.keyframes.size());
  constexpr int kRounds = 2;
  BackendOptions thorough = options;  // all that comes hangs on this one
  thorough.max_iterations *= 3;
  for (int round = 0; round < kRounds; ++round) {
    for (int k = 0; k < keyframes; ++k) {
      map.triangulate_tracks(k, options.min_angle_rad, options.max_error_px);
    }
    if (!adjust_window(map, 0, keyframes, thorough, threads, {})) return std::nullopt;
  }
  int live = 0;
  for (const TrackId id : map.keyframes.back().tracks) {
    live += map.tracks[id].landmark && !map.tracks[id].dead ? 1 : 0;
  }
  if (live < options.start_min_inliers) return std::nullopt;

  const auto map_point = [&](TrackId id) -> const Eigen::Vector3d* {
    const auto it = map.tracks.find(id);
    return it != map.tracks.end() && it->second.landmark ? &it->second.p_world : nullptr;
  };
  int reference = -1;
  for (std::size_t h = 0; h < held_.size(); ++h) {
    if (keyframe_of[h] >= 0) {
      reference = keyframe_of[h];
      started.frames.push_back({held_[h].id, held_[h].time_ns, reference, Pose()});
      continue;
    }
    const Resection r = locate(h, map_point);
    if (!r.ok) continue;
    const int k = std::max(reference, 0);
    const Pose& T = map.keyframes[static_cast<std::size_t>(k)].T_world_camera;
    started.frames.push_back({held_[h].id, held_[h].time_ns, k, T.inverse() * r.T_world_camera});
  }
  disagreement->cost_px2 /= std::max(1, judges);
  disagreement->outliers /= std::max(1, judges);
  return started;
}

std::optional<StartedMap> Starter::attempt(const Camera& camera, int segment,
                                           const Pose& T_world_first, double median_depth,
                                           const BackendOptions& options, int threads) {
  CORVID_CHECK(newest_is_keyframe(), "a start needs a keyframe");
  if (held_.size() < 2) {
    reason_ = "waiting for a second keyframe";
    return std::nullopt;
  }
  const std::optional<Pair> pair = best_pair(camera, options);
  if (!pair) return std::nullopt;
  const TwoView& found = pair->two_view;
  Disagreement found_disagrees;
  auto started = build(camera, segment, T_world_first, median_depth, options, threads, *pair,
                       found.motion, &found_disagrees);
  if (found.rival) {
    Disagreement rival_disagrees;
    auto rival = build(camera, segment, T_world_first, median_depth, options, threads, *pair,
                       *found.rival, &rival_disagrees);
    const bool both = started.has_value() && rival.has_value();
    const double cost = found_disagrees.cost_px2, rival_cost = rival_disagrees.cost_px2;
    if (both && std::max(cost, rival_cost) < 1.1 * std::min(cost, rival_cost)) {
      reason_ = "a plane with two explanations: waiting for a view that tells them apart";
      return std::nullopt;
    }
    if (rival && (!started || rival_cost < cost)) {
      started = std::move(rival);
      found_disagrees = rival_disagrees;
    }
  }
  if (!started) {
    reason_ = "the first points do not hold together";
    return std::nullopt;
  }
  if (found_disagrees.outliers > kMostOutliers) {
    reason_ = "a part of the image moves differently from the rest";
    return std::nullopt;
  }
  return started;
}

}  // namespace corvid
