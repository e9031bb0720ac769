#include "bench/tracking_bench.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "backend/backend.h"
#include "backend/triangulate.h"
#include "bench/timing.h"

namespace corvid {
namespace {

constexpr double kBorderPx = 8;  ///< nearer to the border a template does not fit any more

/// Places of one track, by frame.
using Places = std::vector<std::pair<std::size_t, Eigen::Vector2d>>;
using TruePoses = std::vector<std::optional<Pose>>;

const Eigen::Vector2d* find_place(const Places& places, std::size_t frame) {
  const auto it = std::lower_bound(places.begin(), places.end(), frame,
                                   [](const auto& p, std::size_t f) { return p.first < f; });
  return it != places.end() && it->first == frame ? &it->second : nullptr;
}

/// The point that the places and the true poses give; some two dozen places are used. Nothing where
/// the rays are nearly parallel or do not meet.
std::optional<Eigen::Vector3d> true_point(const Camera& camera, const TruePoses& poses,
                                          const Places& places) {
  constexpr std::size_t kViews = 24;
  constexpr double kMinAngleRad = 0.01, kMaxErrorPx = 20;
  std::vector<RayView> views;
  const std::size_t count = std::min(kViews, places.size());
  for (std::size_t i = 0; i < count; ++i) {
    const auto& [frame, pixel] = places[count < 2 ? 0 : i * (places.size() - 1) / (count - 1)];
    const auto ray = camera.unproject(pixel);
    if (poses[frame] && ray) views.push_back({*poses[frame], pixel, *ray, 1});
  }
  if (views.size() < 2) return std::nullopt;
  const Triangulation point = triangulate(camera, views, kMinAngleRad, kMaxErrorPx);
  if (point.status != TriangulationStatus::ok) return std::nullopt;
  return point.p_world;
}

/// Distance of `pixel` in frame b to the epipolar line of `birth` in frame a, in pixels of the
/// image's centre: focal length times the angle between its ray and the epipolar plane.
std::optional<double> epipolar_error_px(const Camera& camera, const Pose& T_world_a,
                                        const Eigen::Vector2d& birth, const Pose& T_world_b,
                                        const Eigen::Vector2d& pixel) {
  const auto ray_a = camera.unproject(birth), ray_b = camera.unproject(pixel);
  if (!ray_a || !ray_b) return std::nullopt;
  const Pose T_b_a = T_world_b.inverse() * T_world_a;
  const Eigen::Vector3d direction = T_b_a.rotation() * *ray_a;
  const Eigen::Vector3d normal = T_b_a.translation().cross(direction);
  // Without a baseline the line is a point.
  const double angle = normal.norm() > 1e-9
                           ? std::asin(std::min(1.0, std::abs(normal.normalized().dot(*ray_b))))
                           : angle_between(direction, *ray_b);
  return camera.fx_px * angle;
}

bool has_left(const Camera& camera, const TruePoses& poses, const Eigen::Vector3d& p_world,
              std::size_t first, std::size_t last) {
  for (std::size_t f = first; f <= last; ++f) {
    if (!poses[f]) continue;
    const auto pixel = camera.project(poses[f]->inverse() * p_world);
    if (!pixel || !camera.in_image(*pixel, kBorderPx)) return true;
  }
  return false;
}

double quantile(std::vector<double> values, double q) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(q * static_cast<double>(values.size() - 1) + 0.5)];
}

std::optional<double> median_of(const std::vector<double>& values) {
  return values.empty() ? std::nullopt : std::optional(median(values));
}

void score_times(const TrackingRun& run, TrackingRow& row) {
  std::vector<double> wall_ms, cpu_ms, tracks;
  std::vector<std::string> names;  // in order of first appearance
  std::map<std::string, std::vector<double>> parts;
  for (const auto& frame : run.frames) {
    wall_ms.push_back(frame.wall_ms);
    cpu_ms.push_back(frame.cpu_ms);
    tracks.push_back(static_cast<double>(frame.observations.size()));
    row.keyframes += frame.keyframe;
    for (const auto& [name, ms] : frame.parts_ms) {
      if (!parts.contains(name)) names.push_back(name);
      parts[name].push_back(ms);
    }
  }
  const auto mean = [&](int FrontendCounts::*count) {
    double sum = 0;
    for (const auto& frame : run.frames) sum += frame.counts.*count;
    return sum / static_cast<double>(run.frames.size());
  };
  row.sought = mean(&FrontendCounts::before);
  row.found = mean(&FrontendCounts::found);
  row.recovered = mean(&FrontendCounts::recovered);
  row.outliers = mean(&FrontendCounts::epipolar_outliers);
  row.merged = mean(&FrontendCounts::merged);
  row.added = mean(&FrontendCounts::added);
  row.median_ms = median(wall_ms);
  row.p95_ms = quantile(wall_ms, 0.95);
  row.cpu_ms = median(cpu_ms);
  row.tracks = median(tracks);
  for (const std::string& name : names) {
    const auto& times = parts[name];
    double sum = 0;
    for (const double ms : times) sum += ms;
    row.steps.push_back({name, static_cast<int>(times.size()), median(times),
                         sum / static_cast<double>(run.frames.size())});
  }
}

}  // namespace

Expected<TrackingRun> run_tracking_bench(const std::shared_ptr<Device>& device, FrameSource& source,
                                         const FrontendOptions& frontend_options,
                                         const std::stop_token& stop) {
  const SourceInfo& info = source.info();
  auto frontend = Frontend::create(device, frontend_options, info.stills);
  if (!frontend) return tl::unexpected(frontend.error());
  Backend backend({}, info.intrinsics, 0);
  TrackingRun run;
  run.set = info.path;
  run.max_tracks = frontend_options.max_tracks;
  try {
    while (true) {
      run.interrupted = stop.stop_requested();
      if (run.interrupted) break;
      auto frame = source.next(stop);
      if (!frame) return tl::unexpected(frame.error());
      if (!*frame) break;
      run.camera = *(*frame)->camera;
      const auto motion = backend.motion();
      const double wall = wall_ms(), cpu = process_ms();
      FrameTracks tracks = (*frontend)->process(*frame, motion.get());
      run.frames.push_back({(*frame)->time_ns, tracks.keyframe, tracks.observations,
                            wall_ms() - wall, process_ms() - cpu, (*frontend)->last_timings_ms(),
                            (*frontend)->last_counts()});
      (void)backend.add(tracks);
    }
  } catch (const DeviceFault& fault) {
    return fail(ErrorCode::device, fault.what(), device->info().name);
  }
  return run;
}

TrackingRow score_tracking(const TrackingRun& run, const std::vector<std::optional<Pose>>& truth) {
  TrackingRow row;
  row.set = run.set;
  row.width_px = run.camera.width_px;
  row.height_px = run.camera.height_px;
  row.frames = static_cast<int>(run.frames.size());
  row.max_tracks = run.max_tracks;
  for (std::size_t a = 0; a < kTrackAges.size(); ++a) row.ages[a].frames = kTrackAges[a];
  if (run.frames.empty()) return row;
  score_times(run, row);

  TruePoses poses = truth;
  poses.resize(run.frames.size());
  row.has_truth = std::any_of(poses.begin(), poses.end(), [](const auto& p) { return p; });
  std::map<TrackId, Places> tracks;
  for (std::size_t f = 0; f < run.frames.size(); ++f)
    for (const TrackObservation& o : run.frames[f].observations)
      tracks[o.track].emplace_back(f, o.pixel);

  std::array<std::vector<double>, kTrackAges.size()> epipolar_px, reprojection_px;
  for (const auto& [id, places] : tracks) {
    const auto& [birth, birth_px] = places.front();
    const auto point =
        row.has_truth ? true_point(run.camera, poses, places) : std::optional<Eigen::Vector3d>();
    for (std::size_t a = 0; a < kTrackAges.size(); ++a) {
      TrackAge& age = row.ages[a];
      const std::size_t then = birth + static_cast<std::size_t>(age.frames);
      if (then >= run.frames.size()) continue;
      ++age.born;
      const Eigen::Vector2d* const pixel = find_place(places, then);
      if (!pixel) {
        age.left += point && has_left(run.camera, poses, *point, birth, then);
        continue;
      }
      ++age.alive;
      if (!poses[birth] || !poses[then]) continue;
      if (const auto error =
              epipolar_error_px(run.camera, *poses[birth], birth_px, *poses[then], *pixel))
        epipolar_px[a].push_back(*error);
      if (!point) continue;
      if (const auto x = run.camera.project(poses[then]->inverse() * *point))
        reprojection_px[a].push_back((*x - *pixel).norm());
    }
  }
  for (std::size_t a = 0; a < kTrackAges.size(); ++a) {
    row.ages[a].epipolar_px = median_of(epipolar_px[a]);
    row.ages[a].reprojection_px = median_of(reprojection_px[a]);
  }
  return row;
}

}  // namespace corvid
