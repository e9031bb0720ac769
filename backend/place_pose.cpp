#include "backend/place_pose.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "backend/resect.h"
#include "core/median.h"

namespace corvid {
namespace {

constexpr int kMinInliers = 30;
constexpr double kMinShare = 0.5;  // of the views must agree with the pose
constexpr std::size_t kMinRatios = 10;
constexpr double kRatioTolerance = 0.2;
constexpr double kBesidePx = 8;  // neighbours that are taken to be equally far

/// Landmarks of the map in the query.
struct Views {
  std::vector<PlaceInlier> seen;
  std::vector<PointView> points;

  void add(const MapData& map, const FusedTracks& fused, const PlaceReference& reference) {
    for (const PlaceView& v : reference.views) {
      const TrackId id = resolve(fused, v.landmark);
      const auto it = map.tracks.find(id);
      if (it == map.tracks.end() || !it->second.landmark || !v.pixel.allFinite()) continue;
      const bool known = std::any_of(seen.begin(), seen.end(),
                                     [&](const PlaceInlier& s) { return s.landmark == id; });
      if (known) continue;
      const TrackObservation o{id, v.pixel, 1, v.covariance_px2};
      seen.push_back({id, o});
      points.push_back({it->second.p_world, v.pixel, floored_sigma_px(o)});
    }
  }
};

std::optional<std::size_t> keyframe_of(const MapData& map, FrameId frame) {
  for (std::size_t k = map.keyframes.size(); k-- > 0;)
    if (map.keyframes[k].frame->id == frame) return k;
  return std::nullopt;
}

bool agree(const Resection& r, std::size_t points) {
  return r.ok && r.inliers >= kMinShare * static_cast<double>(points);
}

}  // namespace

TrackId resolve(const FusedTracks& fused, TrackId id) {
  for (auto it = fused.find(id); it != fused.end(); it = fused.find(id)) id = it->second;
  return id;
}

PlacePose place_pose(const MapData& map, const FusedTracks& fused, const PlaceMatch& match,
                     const BackendOptions& options) {
  PlacePose place;
  const auto refuse = [&](std::string why) {
    place.refusal = std::move(why);
    return place;
  };
  ResectSettings settings;
  settings.max_error_px = options.max_error_px;
  settings.huber_px = options.huber_px;
  settings.min_inliers = kMinInliers;
  settings.seed = options.seed;
  settings.max_trials = 1000;

  Views all;
  std::vector<Resection> alone;
  std::vector<Views> views;
  std::size_t most = 0;
  for (const PlaceReference& reference : match.references) {
    const auto k = keyframe_of(map, reference.keyframe);
    if (!k) continue;
    const int segment = map.keyframes[*k].segment;
    if (!views.empty() && segment != place.segment) continue;
    place.segment = segment;
    Views own;
    own.add(map, fused, reference);
    if (own.points.size() > most) {
      most = own.points.size();
      const auto& host = map.keyframes[*k].host;  // it may have come to rest since
      place.reference = host ? host->keyframe : static_cast<int>(*k);
    }
    alone.push_back(resect(map.camera, own.points, std::nullopt, settings));
    views.push_back(std::move(own));
    all.add(map, fused, reference);
  }
  const Resection r = resect(map.camera, all.points, std::nullopt, settings);
  if (!agree(r, all.points.size()))
    return refuse(fmt::format("{} of {} landmarks agree on a pose", r.inliers, all.points.size()));
  const Pose T_query_world = r.T_world_camera.inverse();
  const double max2 = options.max_error_px * options.max_error_px;
  for (std::size_t i = 0; i < views.size(); ++i) {
    if (!agree(alone[i], views[i].points.size())) continue;
    const auto fits =
        std::count_if(views[i].points.begin(), views[i].points.end(), [&](const PointView& p) {
          const auto pixel = map.camera.project(T_query_world * p.p_world);
          return pixel && (*pixel - p.pixel).squaredNorm() < 4 * max2;
        });
    if (static_cast<double>(fits) < kMinShare * alone[i].inliers)
      return refuse("two keyframes that look alike give different poses");
  }
  for (std::size_t i = 0; i < all.seen.size(); ++i)
    if (r.inlier[i] != 0) place.inliers.push_back(all.seen[i]);
  std::sort(place.inliers.begin(), place.inliers.end(),
            [](const auto& a, const auto& b) { return a.landmark < b.landmark; });
  std::vector<Eigen::Vector2d> pixels;
  for (const PlaceInlier& i : place.inliers) pixels.push_back(i.seen.pixel);
  if (const int parts = parts_seen(map.camera, pixels); parts < kMinPartsSeen)
    return refuse(fmt::format("the landmarks lie in {} of 16 parts of the image", parts));
  place.T_world_query = r.T_world_camera;
  place.covariance = r.covariance;
  place.ok = true;
  return place;
}

std::vector<std::pair<std::size_t, std::size_t>> pair_up(
    std::span<const PlaceInlier> inliers, std::span<const TrackObservation> observations,
    double distance_px) {
  struct Candidate {
    double distance2;
    std::size_t inlier, observation;
  };
  std::vector<Candidate> candidates;
  for (std::size_t i = 0; i < inliers.size(); ++i)
    for (std::size_t k = 0; k < observations.size(); ++k) {
      const double d2 = (inliers[i].seen.pixel - observations[k].pixel).squaredNorm();
      if (d2 <= distance_px * distance_px) candidates.push_back({d2, i, k});
    }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const auto& a, const auto& b) { return a.distance2 < b.distance2; });
  std::vector<std::uint8_t> inlier_taken(inliers.size(), 0), taken(observations.size(), 0);
  std::vector<std::pair<std::size_t, std::size_t>> pairs;
  for (const Candidate& c : candidates) {
    if (inlier_taken[c.inlier] != 0 || taken[c.observation] != 0) continue;
    inlier_taken[c.inlier] = taken[c.observation] = 1;
    pairs.emplace_back(c.inlier, c.observation);
  }
  return pairs;
}

double scale_ratio(const MapData& map, const PlacePose& place, const Pose& T_own_query,
                   std::span<const TrackObservation> observations) {
  std::vector<double> ratios;
  const Pose T_query_world = place.T_world_query.inverse(), T_query_own = T_own_query.inverse();
  for (const auto& [i, k] : pair_up(place.inliers, observations, kBesidePx)) {
    const auto old = map.tracks.find(place.inliers[i].landmark);
    const auto own = map.tracks.find(observations[k].track);
    if (old == map.tracks.end() || own == map.tracks.end() || old == own) continue;
    if (!old->second.landmark || !own->second.landmark) continue;
    const double far = (T_query_world * old->second.p_world).norm();
    const double near = (T_query_own * own->second.p_world).norm();
    if (near > 0 && far > 0) ratios.push_back(far / near);
  }
  if (ratios.size() < kMinRatios) return 0;
  const double median = upper_median(ratios);
  const auto good =
      static_cast<std::size_t>(std::count_if(ratios.begin(), ratios.end(), [&](double r) {
        return std::abs(r / median - 1) < kRatioTolerance;
      }));
  return good >= kMinRatios && 2 * good >= ratios.size() ? median : 0;
}

}  // namespace corvid
