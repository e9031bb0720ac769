#include "bench/mapping_bench.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "bench/timing.h"
#include "kernels/depth.h"
#include "kernels/warp.h"
#include "mapping/depth_clean.h"
#include "mapping/mapper.h"
#include "mapping/ray_grid.h"
#include "mapping/view_choice.h"

namespace corvid {
namespace {

constexpr int kNeighbours = 4, kRefinements = 2;
constexpr double kMinIsland = 5e-4;  ///< as the mapping stage has it

/// What a work needs, prepared outside the timed part.
struct Prepared {
  const DepthWork* work = nullptr;
  Camera camera;
  FramePtr frame;
  std::vector<SweepImage> images;
  std::vector<SweepNeighbour> neighbours;
  DepthInterval interval;
  int depths = 0;
  std::vector<GridRay> rays;
  double answered = 0, scores = 0;  ///< of the last run
};

/// The voxel size that gives about so many rays.
Expected<std::vector<GridRay>> rays_through(const DepthWork& work, const Camera& camera,
                                            const Pose& T_world_camera) {
  double low = 1e-4 * work.volume.sizes().maxCoeff(), high = work.volume.sizes().maxCoeff();
  std::vector<GridRay> best;
  constexpr int kHalvings = 30;
  const auto off = [&](const std::vector<GridRay>& rays) {
    return std::abs(static_cast<double>(rays.size()) - work.rays);
  };
  // From above: the number of rays rises without bound as voxels shrink.
  low = std::max(low, high / (2 * std::sqrt(work.rays)));
  for (int i = 0; i < kHalvings; ++i) {
    const double size = std::sqrt(low * high);
    auto rays = far_side_rays({work.volume, size}, camera, T_world_camera);
    (static_cast<double>(rays.size()) > work.rays ? low : high) = size;
    if (best.empty() || off(rays) < off(best)) best = std::move(rays);
  }
  if (off(best) > 0.02 * work.rays) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("no voxel size gives {:.0f} rays", work.rays), work.workload);
  }
  return best;
}

DepthInterval true_interval(const TrueView& view) {
  std::vector<float> depths;
  for (std::size_t i = 0; i < view.depth.size(); i += 7) {
    if (view.depth.data()[i] > 0) depths.push_back(view.depth.data()[i]);
  }
  if (depths.size() < 2) return {1, 2};
  std::sort(depths.begin(), depths.end());
  constexpr double kMargin = 1.5;
  return {depths[depths.size() / 100] / kMargin,
          depths[depths.size() - 1 - depths.size() / 100] * kMargin};
}

Expected<Prepared> prepare(const std::shared_ptr<Device>& device, DepthSweeper& sweeper,
                           const DepthWork& work) {
  const std::vector<TrueView>& views = work.scene->views;
  const TrueView& reference = views[work.view];
  Prepared out;
  out.work = &work;
  out.frame = reference.frame;
  out.camera = reference.frame->camera->undistorted();
  if (!(out.camera == *reference.frame->camera)) {
    return fail(ErrorCode::invalid_argument,
                "its lens is distorted, and the timed work does not undistort", work.workload,
                "give images of a pinhole camera");
  }
  std::vector<Pose> poses;
  for (const TrueView& view : views) poses.push_back(view.T_world_camera);
  Eigen::Vector3d p_scene;
  if (work.volume.isEmpty()) {
    out.interval = true_interval(reference);
    const double middle = 2 / (1 / out.interval.near + 1 / out.interval.far);
    p_scene = reference.T_world_camera * Eigen::Vector3d(0, 0, middle);
  } else {
    const auto interval = depth_interval(work.volume, reference.T_world_camera);
    if (!interval) {
      return fail(ErrorCode::invalid_argument, "the volume is behind the view", work.workload);
    }
    out.interval = *interval;
    p_scene = work.volume.center();
    auto rays = rays_through(work, *reference.frame->camera, reference.T_world_camera);
    if (!rays) return tl::unexpected(rays.error());
    out.rays = std::move(*rays);
  }
  ViewChoiceOptions choice;
  choice.neighbours = kNeighbours;
  const auto chosen =
      choose_neighbours(poses, *reference.frame->camera, work.view, p_scene, choice);
  if (static_cast<int>(chosen.size()) < kNeighbours) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("only {} views see what view {} sees", chosen.size(), work.view),
                work.workload);
  }
  std::vector<Pose> T_neighbours;
  out.images.reserve(chosen.size());
  for (const Neighbour& n : chosen) {
    T_neighbours.push_back(poses[n.index].inverse() * reference.T_world_camera);
    out.images.push_back(sweeper.prepare(upload(*device, views[n.index].frame->grey), 1));
    out.neighbours.push_back({&out.images.back(), out.camera, T_neighbours.back()});
  }
  out.depths =
      work.depths > 0 ? work.depths : depth_samples(out.camera, T_neighbours, out.interval);
  return out;
}

void run(const std::shared_ptr<Device>& device, DepthSweeper& sweeper, Prepared& p) {
  const SweepImage reference =
      sweeper.prepare(upload(*device, p.frame->grey, Lane::mapping), 1, Lane::mapping);
  SweepResult result = sweeper.estimate({&reference, p.camera, p.neighbours, p.interval.near,
                                         p.interval.far, p.depths, true, kRefinements});
  DepthMap map;
  map.camera = p.camera;
  map.depth = std::move(result.depth);
  map.confidence = std::move(result.confidence);
  weaken_ambiguous(map, result.lead);
  remove_speckles(map, static_cast<int>(kMinIsland * static_cast<double>(map.depth.size())));
  std::vector<float> depths(map.depth.data(), map.depth.data() + map.depth.size());
  if (!p.rays.empty()) depths = depths_of(p.rays, *p.frame->camera, map);
  p.answered = static_cast<double>(
                   std::count_if(depths.begin(), depths.end(), [](float z) { return z > 0; })) /
               static_cast<double>(depths.size());
  p.scores = result.scores;
}

}  // namespace

Expected<void> time_depth(const std::shared_ptr<Device>& device, PeakMeter& peak,
                          const std::vector<DepthWork>& works, int runs,
                          const std::stop_token& stop, MappingReport& report) {
  const DepthSweepOptions options;
  auto sweeper = DepthSweeper::create(device, options);
  if (!sweeper) return tl::unexpected(sweeper.error());
  try {
    std::vector<Prepared> prepared;
    prepared.reserve(works.size());
    for (const DepthWork& work : works) {
      auto p = prepare(device, *sweeper, work);
      if (!p) return tl::unexpected(p.error());
      prepared.push_back(std::move(*p));
    }
    std::vector<TimedWork> timed;
    for (Prepared& p : prepared)
      timed.push_back({[&] { run(device, *sweeper, p); }, [&] { peak.measure(); }});
    const std::vector<Timing> timings = time_in_turn(timed, runs, stop);
    report.interrupted = timings.empty();
    report.peak_gflops = peak.measurements() > 0 ? peak.fma_gflops() : 0;
    for (std::size_t i = 0; i < timings.size(); ++i) {
      const Prepared& p = prepared[i];
      MappingRow row;
      row.workload = p.work->workload;
      row.rays = p.rays.empty() ? static_cast<double>(p.camera.width_px) * p.camera.height_px
                                : static_cast<double>(p.rays.size());
      row.views = kNeighbours;
      row.depths = p.depths;
      row.seconds = 1e-3 * timings[i].median_ms;
      row.cpu_s = 1e-3 * timings[i].cpu_ms;
      constexpr double kOperations = 12;  // 3 sums, along rows and columns, a multiply-add each
      row.share_of_peak = kOperations * options.template_px * p.scores /
                          (1e6 * timings[i].median_ms * report.peak_gflops);
      row.answered = p.answered;
      report.rows.push_back(row);
    }
  } catch (const DeviceFault& fault) {
    return fail(ErrorCode::device, fault.what(), device->info().name);
  }
  return {};
}

Expected<std::optional<MappingRow>> score_mapping(const std::shared_ptr<Device>& device,
                                                  const MappingScene& scene,
                                                  const std::stop_token& stop) {
  MappingOptions options;
  options.depth_scale = 1;
  auto mapper = Mapper::create(device, options, nullptr);
  if (!mapper) return tl::unexpected(mapper.error());
  try {
    (*mapper)->finish(true_map(scene), stop);
  } catch (const DeviceFault& fault) {
    return fail(ErrorCode::device, fault.what(), device->info().name);
  }
  if (stop.stop_requested()) return std::nullopt;
  std::vector<std::shared_ptr<const DepthMap>> depth_maps;
  for (const StoredDepth& stored : (*mapper)->depth_maps()) depth_maps.push_back(stored.scaled());
  const DepthScore score = score_depth(scene, depth_maps);
  MappingRow row;
  row.workload = "accuracy, " + scene.name;
  row.views = score.maps;
  row.depths = options.depth_samples;
  row.answered = score.answered;
  row.within_1 = score.within_1;
  row.within_2 = score.within_2;
  row.median_error_m = score.median_error_m;
  return row;
}

}  // namespace corvid
