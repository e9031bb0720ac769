#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "bench/mapping_bench.h"
#include "bench/timing.h"
#include "core/log.h"
#include "mapping/cut_mesh.h"
#include "mapping/still_cut.h"

namespace corvid {

Expected<void> time_snapshots(const std::shared_ptr<Device>& device, const MappingScene& scene,
                              const Eigen::AlignedBox3d& volume, const std::vector<double>& voxels,
                              int runs, const std::stop_token& stop, MappingReport& report) {
  std::vector<StillView> views;
  for (const TrueView& view : scene.views) views.push_back({view.frame, view.T_world_camera});
  const auto depths = depth_of_stills(device, views, {}, [&](std::size_t i) {
    log().info("depth of view {} of {}", i + 1, views.size());
    return !stop.stop_requested();
  });
  if (!depths && depths.error().code == ErrorCode::interrupted) {
    report.interrupted = true;
    return {};
  }
  if (!depths) return tl::unexpected(depths.error());
  for (const double wanted : voxels) {
    SurfaceCutOptions options;
    options.box = volume;
    options.voxel_size = std::cbrt(volume.volume() / wanted);
    std::optional<Error> error;
    SurfaceCut cut;
    std::vector<double> graph_s, maxflow_s;
    const std::vector<TimedWork> work{{[&] {
      if (error) return;
      auto made = cut_stills(views, *depths, options, {stop, {}});
      if (!made) {
        error = made.error();
        return;
      }
      cut = std::move(*made);
      graph_s.push_back(cut.statistics.graph_s);
      maxflow_s.push_back(cut.statistics.maxflow_s);
    }}};
    const auto timings = time_in_turn(work, runs, stop);
    report.interrupted = timings.empty();
    if (report.interrupted) return {};
    if (error) return tl::unexpected(*error);
    // The first run is not timed.
    graph_s.erase(graph_s.begin());
    maxflow_s.erase(maxflow_s.begin());
    MappingRow row;
    row.workload = "snapshot, " + scene.name;
    row.views = static_cast<int>(std::count_if(
        depths->begin(), depths->end(), [](const StillDepth& d) { return d.refusal.empty(); }));
    row.seconds = 1e-3 * timings[0].median_ms;
    row.cpu_s = 1e-3 * timings[0].cpu_ms;
    row.voxels = static_cast<double>(cut.statistics.voxels);
    row.graph_s = median(graph_s);
    row.maxflow_s = median(maxflow_s);
    row.peak_mb = 1e-6 * static_cast<double>(cut.statistics.peak_bytes);
    row.unpaired_sides = static_cast<double>(unpaired_sides(cut.mesh));
    report.rows.push_back(row);
  }
  return {};
}

}  // namespace corvid
