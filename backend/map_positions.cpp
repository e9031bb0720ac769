#include "backend/map_positions.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "core/clock.h"
#include "core/median.h"

namespace corvid {
namespace {

constexpr std::int64_t kExact_ns = 1'000'000;        // a fix this near needs no interpolation
constexpr std::int64_t kLatest_ns = 60'000'000'000;  // a fix may come this late
constexpr double kAcceleration_mps2 = 2;  // of the camera between two fixes, standard deviation
constexpr std::size_t kNewest = 512;      // positions that the running alignment looks at
constexpr double kDriftShare = 0.02;      // of the way flown: drift of a map, standard deviation
constexpr double kBendShare = 0.005;      // of its extent: what is left of it in a straight one
constexpr double kFits = 0.9;             // of the positions that fit nearby must fit the whole
constexpr std::size_t kNodeEvery = 8;     // positions

double seconds(std::int64_t ns) { return 1e-9 * static_cast<double>(ns); }

}  // namespace

void MapPositions::add(std::span<const PositionFix> fixes) {
  for (const PositionFix& fix : fixes) {
    if (!fix.problem().empty()) continue;
    const Fix f{fix.time_ns, to_ecef(fix.position), fix.covariance_m2};
    if (!frame_) frame_.emplace(fix.position);
    if (!fix.frame_name.empty()) {
      by_name_.emplace(fix.frame_name, f);
      continue;
    }
    if (difference_s(newest_frame_ns_, f.time_ns) > seconds(kLatest_ns)) continue;
    const auto place =
        std::lower_bound(fixes_.begin(), fixes_.end(), f.time_ns,
                         [](const Fix& a, std::int64_t time_ns) { return a.time_ns < time_ns; });
    if (place != fixes_.end() && place->time_ns == f.time_ns) continue;
    fixes_.insert(place, f);
  }
}

// Between two fixes the path is a straight line; what an accelerated camera deviates from it,
// a/2 (t - t0) (t1 - t), is noise. Keyframes that share a fix share its weight.
std::optional<MapPositions::Fix> MapPositions::at(const StoredFrame& frame,
                                                  double since_last_s) const {
  if (const auto named = by_name_.find(frame.name); named != by_name_.end() && !frame.name.empty())
    return named->second;
  const auto after =
      std::lower_bound(fixes_.begin(), fixes_.end(), frame.time_ns,
                       [](const Fix& a, std::int64_t time_ns) { return a.time_ns < time_ns; });
  if (after != fixes_.end() && difference_s(after->time_ns, frame.time_ns) <= seconds(kExact_ns))
    return *after;
  if (after == fixes_.begin()) return std::nullopt;
  const Fix& a = *std::prev(after);
  if (difference_s(frame.time_ns, a.time_ns) <= seconds(kExact_ns)) return a;
  if (after == fixes_.end()) return std::nullopt;
  const Fix& b = *after;
  const double gap_s = difference_s(b.time_ns, a.time_ns);
  if (gap_s > options_.max_position_gap_s) return std::nullopt;
  const double from_a_s = seconds(frame.time_ns - a.time_ns), to_b_s = gap_s - from_a_s;
  const double share = from_a_s / gap_s;
  const double bend_m = 0.5 * kAcceleration_mps2 * from_a_s * to_b_s;
  Fix out{frame.time_ns, (1 - share) * a.p_ecef + share * b.p_ecef,
          (1 - share) * a.covariance_m2 + share * b.covariance_m2};
  out.covariance_m2 *= std::max(1.0, gap_s / std::max(1e-3, since_last_s));
  out.covariance_m2 += bend_m * bend_m * Eigen::Matrix3d::Identity();
  return out;
}

void MapPositions::match(const MapData& map) {
  matches_.resize(map.keyframes.size());
  bool still_settled = true;
  for (std::size_t k = settled_; k < map.keyframes.size(); ++k) {
    const StoredFrame& frame = *map.keyframes[k].frame;
    newest_frame_ns_ = std::max(newest_frame_ns_, frame.time_ns);
    const double since_last_s =
        k > 0 ? std::abs(difference_s(frame.time_ns, map.keyframes[k - 1].frame->time_ns)) : 60.0;
    matches_[k].fix = at(frame, since_last_s);
  }
  // Later fixes can no longer change what lies a minute back.
  for (std::size_t k = settled_; k < map.keyframes.size() && still_settled; ++k) {
    still_settled =
        difference_s(newest_frame_ns_, map.keyframes[k].frame->time_ns) > 2 * seconds(kLatest_ns);
    if (still_settled) settled_ = k + 1;
  }
  if (settled_ > 0) forget(map.keyframes[settled_ - 1].frame->time_ns);
}

void MapPositions::forget(std::int64_t settled_ns) {
  while (!fixes_.empty() && difference_s(settled_ns, fixes_.front().time_ns) > seconds(kLatest_ns))
    fixes_.pop_front();
}

/// Points of `placed`, their covariances enlarged by the drift of the map: a share of the way from
/// keyframe `reference`. Without one: a share of the path's extent.
std::vector<PlacedPoint> MapPositions::points_seen_from(
    const MapData& map, const std::vector<std::size_t>& placed,
    std::optional<std::size_t> reference) const {
  std::vector<PlacedPoint> points;
  std::vector<double> way;  // flown up to each point [map units]
  std::vector<double> of_map[3], of_earth[3];
  for (const std::size_t k : placed) {
    PlacedPoint p;
    p.p_map = map.keyframes[k].T_world_camera.translation();
    p.p_enu_m = frame_->to_enu(matches_[k].fix->p_ecef);
    p.covariance_m2 = matches_[k].fix->covariance_m2;
    way.push_back(points.empty() ? 0 : way.back() + (p.p_map - points.back().p_map).norm());
    points.push_back(p);
    for (int i = 0; i < 3; ++i) {
      of_map[i].push_back(p.p_map(i));
      of_earth[i].push_back(p.p_enu_m(i));
    }
  }
  if (points.empty()) return points;
  const Eigen::Vector3d middle_map(upper_median(of_map[0]), upper_median(of_map[1]),
                                   upper_median(of_map[2]));
  const Eigen::Vector3d middle_earth(upper_median(of_earth[0]), upper_median(of_earth[1]),
                                     upper_median(of_earth[2]));
  std::vector<double> extents_map, extents_m;
  for (const PlacedPoint& p : points) {
    extents_map.push_back((p.p_map - middle_map).norm());
    extents_m.push_back((p.p_enu_m - middle_earth).norm());
  }
  const double extent_map = upper_median(extents_map), extent_m = upper_median(extents_m);
  const double rough_scale = extent_map > 0 ? extent_m / extent_map : 0;
  const auto here =
      reference ? std::lower_bound(placed.begin(), placed.end(), *reference) : placed.end();
  const double way_here =
      way[std::min(static_cast<std::size_t>(here - placed.begin()), way.size() - 1)];
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double drift_m =
        reference ? kDriftShare * rough_scale * std::abs(way[i] - way_here) : kBendShare * extent_m;
    points[i].covariance_m2.diagonal().array() += drift_m * drift_m;
  }
  return points;
}

GeoAlignment MapPositions::align(const MapData& map, const std::vector<std::size_t>& placed,
                                 std::optional<std::size_t> reference,
                                 const std::optional<Sim3>& guess) const {
  GeoAlignmentSettings settings;
  settings.max_scale_sigma = options_.max_scale_sigma;
  settings.seed = options_.seed;
  return align_to_positions(points_seen_from(map, placed, reference), settings, guess);
}

std::vector<std::size_t> MapPositions::placed_keyframes(const MapData& map, int segment) const {
  std::vector<std::size_t> placed;
  for (std::size_t k = 0; k < matches_.size(); ++k) {
    if (map.keyframes[k].segment == segment && matches_[k].fix) placed.push_back(k);
  }
  return placed;
}

std::optional<Sim3> MapPositions::known(int segment) const {
  const auto it = placements_.find(segment);
  if (it == placements_.end() || it->second->scale != MapScale::metric) return std::nullopt;
  return it->second->T_enu_map;
}

void MapPositions::publish(MapData& map, int segment, const std::vector<std::size_t>& placed,
                           const GeoAlignment& a) {
  auto placement = std::make_shared<MapPlacement>();
  placement->origin = frame_->origin();
  bool empty = true;
  for (MapKeyframe& keyframe : map.keyframes) {
    if (keyframe.segment != segment) continue;
    keyframe.position.reset();
    empty = false;
  }
  if (empty) {  // it became part of another one
    placements_.erase(segment);
    return;
  }
  if (!a.ok()) {
    placement->reason = a.reason;
  } else {
    placement->scale = MapScale::metric;
    placement->T_enu_map = a.T_enu_map;
    placement->covariance = a.covariance;
    placement->rmse_m = a.rmse_m;
    const Sim3 T_map_enu = a.T_enu_map.inverse();
    const Eigen::Matrix3d sR = a.T_enu_map.scale() * a.T_enu_map.rotation().toRotationMatrix();
    for (std::size_t i = 0; i < placed.size(); ++i) {
      Match& match = matches_[placed[i]];
      MapKeyframe& keyframe = map.keyframes[placed[i]];
      match.inlier = a.inlier[i] != 0;
      if (!match.inlier) continue;
      const Eigen::LLT<Eigen::Matrix3d> llt(match.fix->covariance_m2);
      keyframe.position =
          PositionPrior{T_map_enu * frame_->to_enu(match.fix->p_ecef), llt.matrixL().solve(sR)};
    }
  }
  for (std::size_t k = 0; k < matches_.size(); ++k) {
    if (map.keyframes[k].segment != segment || !matches_[k].fix) continue;
    ++placement->positions;
    placement->inliers += a.ok() && matches_[k].inlier ? 1 : 0;
  }
  placements_[segment] = std::move(placement);
}

void MapPositions::follow(MapData& map, int segment) {
  if (!frame_) return;
  match(map);
  std::vector<std::size_t> placed = placed_keyframes(map, segment);
  if (placed.size() > kNewest)
    placed.erase(placed.begin(), placed.end() - static_cast<std::ptrdiff_t>(kNewest));
  const auto both = [&] {
    GeoAlignment here = align(map, placed, map.keyframes.size() - 1, known(segment));
    if (here.ok()) return here;
    // A map that has not bent at all may know more from afar.
    GeoAlignment all = align(map, placed, std::nullopt, known(segment));
    return all.ok() ? all : here;
  };
  GeoAlignment a = both();
  if (a.ok() && !frame_is_final_) {
    const auto agrees = std::find(a.inlier.begin(), a.inlier.end(), std::uint8_t{1});
    const std::size_t k = placed[static_cast<std::size_t>(agrees - a.inlier.begin())];
    frame_.emplace(to_geodetic(matches_[k].fix->p_ecef));
    frame_is_final_ = true;
    a = both();
  }
  publish(map, segment, placed, a);
}

bool MapPositions::place_whole(MapData& map, int segment) {
  if (!frame_) return true;
  follow(map, segment);
  if (!known(segment)) return true;  // nothing that one could fit
  const std::vector<std::size_t> placed = placed_keyframes(map, segment);
  const auto near = std::count_if(placed.begin(), placed.end(),
                                  [&](std::size_t k) { return matches_[k].inlier; });
  const GeoAlignment a = align(map, placed, std::nullopt, known(segment));
  if (a.ok()) publish(map, segment, placed, a);
  return a.ok() && a.inliers >= kFits * static_cast<double>(near);
}

std::vector<Sim3> MapPositions::straightened(const MapData& map, int segment) {
  std::vector<Sim3> T_world_keyframe;
  for (const MapKeyframe& k : map.keyframes)
    T_world_keyframe.emplace_back(1, k.T_world_camera.rotation(), k.T_world_camera.translation());
  const auto reference = known(segment);
  if (!reference) return T_world_keyframe;
  const std::vector<std::size_t> placed = placed_keyframes(map, segment);
  std::vector<std::pair<std::size_t, Sim3>> nodes;
  for (std::size_t i = 0; i < placed.size(); i += kNodeEvery) {
    const std::size_t begin = i > kNewest / 2 ? i - kNewest / 2 : 0;
    const std::size_t end = std::min(placed.size(), i + kNewest / 2);
    const std::vector<std::size_t> near(placed.begin() + static_cast<std::ptrdiff_t>(begin),
                                        placed.begin() + static_cast<std::ptrdiff_t>(end));
    const GeoAlignment a = align(map, near, placed[i],
                                 nodes.empty() ? std::nullopt : std::optional(nodes.back().second));
    if (!a.ok()) continue;
    nodes.emplace_back(placed[i], a.T_enu_map);
    for (std::size_t k = i; k < std::min(end, i + kNodeEvery); ++k)
      matches_[placed[k]].inlier = a.inlier[k - begin] != 0;
  }
  if (nodes.empty()) return T_world_keyframe;
  std::size_t next = 0;
  for (std::size_t k = 0; k < map.keyframes.size(); ++k) {
    if (map.keyframes[k].segment != segment) continue;
    while (next < nodes.size() && nodes[next].first < k) ++next;
    const auto& [after, T_after] = nodes[std::min(next, nodes.size() - 1)];
    const auto& [before, T_before] = nodes[next > 0 ? next - 1 : 0];
    const double share = after > before
                             ? std::clamp((static_cast<double>(k) - static_cast<double>(before)) /
                                              static_cast<double>(after - before),
                                          0.0, 1.0)
                             : 0.0;
    const Vector7d step = (T_before.inverse() * T_after).log();
    T_world_keyframe[k] =
        reference->inverse() * T_before * Sim3::exp(share * step) * T_world_keyframe[k];
  }
  return T_world_keyframe;
}

std::shared_ptr<const MapPlacement> MapPositions::placement(int segment) const {
  const auto it = placements_.find(segment);
  if (it != placements_.end()) return it->second;
  if (!frame_) return nullptr;
  auto waiting = std::make_shared<MapPlacement>();
  waiting->reason = "no map yet";
  waiting->origin = frame_->origin();
  return waiting;
}

}  // namespace corvid
