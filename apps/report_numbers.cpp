#include "apps/report_numbers.h"

#include <sys/utsname.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <numeric>
#include <set>
#include <thread>

namespace corvid {
namespace {

/// Value of "key<separator> value" in a small text file.
std::string value_in(const char* path, std::string_view key, char separator) {
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    if (!std::string_view(line).starts_with(key)) continue;
    std::size_t begin = line.find(separator);
    if (begin == std::string::npos) continue;
    begin = line.find_first_not_of(" \t\"", begin + 1);
    if (begin == std::string::npos) return {};
    return line.substr(begin, line.find_last_not_of(" \t\"") + 1 - begin);
  }
  return {};
}

double mesh_area(const TriangleMesh& mesh) {
  double area = 0;
  const std::size_t n = mesh.vertices.size();
  for (const auto& t : mesh.triangles) {
    if (std::max({t[0], t[1], t[2]}) >= n) continue;
    const Eigen::Vector3d a = mesh.vertices[t[0]].cast<double>();
    const double twice = (mesh.vertices[t[1]].cast<double>() - a)
                             .cross(mesh.vertices[t[2]].cast<double>() - a)
                             .norm();
    if (std::isfinite(twice)) area += twice / 2;
  }
  return area;
}

}  // namespace

Spread spread_of(std::vector<double> values) {
  std::erase_if(values, [](double v) { return !std::isfinite(v); });
  Spread out;
  out.count = values.size();
  if (values.empty()) return out;
  std::sort(values.begin(), values.end());
  const auto quantile = [&](double q) {
    const auto rank = static_cast<std::size_t>(std::ceil(q * static_cast<double>(values.size())));
    return values[std::clamp<std::size_t>(rank, 1, values.size()) - 1];
  };
  out.mean =
      std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
  out.median = quantile(0.5);
  out.p95 = quantile(0.95);
  out.p99 = quantile(0.99);
  out.max = values.back();
  return out;
}

RunNumbers count_run(const RunResult& result) {
  RunNumbers n;
  n.delivered = result.counts.delivered;
  n.skipped = result.counts.skipped;
  n.dropped = result.counts.dropped;
  n.lost = result.counts.lost;
  n.interruptions = result.counts.interruptions;

  std::vector<double> tracks, inliers, rms, latency;
  std::optional<std::int64_t> first_pose_ns;
  std::set<int> segments;  // of the final map, where there is one: some may have been joined
  for (const PoseEvent& e : result.events) {
    ++n.events;
    const auto state = static_cast<std::size_t>(e.state);
    if (state < n.states.size()) ++n.states[state];
    n.keyframe_events += e.keyframe ? 1 : 0;
    if (e.latency_ms > 0) latency.push_back(e.latency_ms);  // else there was no picture
    tracks.push_back(e.tracks);
    if (e.T_world_camera) {
      if (!first_pose_ns) first_pose_ns = e.time_ns;
      ++n.with_pose;
      inliers.push_back(e.inliers);
      rms.push_back(std::sqrt(std::max(e.mse_px2, 0.0)));
      segments.insert(e.segment);
    } else if (first_pose_ns) {
      ++n.untracked_after_start;
    }
  }
  if (!result.events.empty()) {
    const std::int64_t begin_ns = result.events.front().time_ns;
    n.capture_s = static_cast<double>(result.events.back().time_ns - begin_ns) * 1e-9;
    if (first_pose_ns) n.start_s = static_cast<double>(*first_pose_ns - begin_ns) * 1e-9;
  }
  if (result.wall_s > 0) {
    n.frames_per_s = static_cast<double>(n.events) / result.wall_s;
    if (!result.source.stills) n.realtime_factor = n.capture_s / result.wall_s;
  }
  n.tracks = spread_of(std::move(tracks));
  n.inliers = spread_of(std::move(inliers));
  n.rms_px = spread_of(std::move(rms));
  n.latency_ms = spread_of(std::move(latency));

  n.poses = result.trajectory.size();
  for (std::size_t i = 1; i < result.trajectory.size(); ++i) {
    const double step = (result.trajectory[i].T_world_camera.translation() -
                         result.trajectory[i - 1].T_world_camera.translation())
                            .norm();
    if (std::isfinite(step)) n.path_length += step;
  }
  if (result.map) {
    segments.clear();
    for (const auto& keyframe : result.map->keyframes) segments.insert(keyframe->segment);
    n.keyframes = result.map->keyframes.size();
    n.landmarks = result.map->landmarks.size();
    for (const auto& keyframe : result.map->keyframes) {
      n.observations += keyframe->observations.size();
    }
  }

  n.segments = static_cast<int>(segments.size());

  DepthAnswers answers;
  for (const StoredDepth& stored : result.depth_maps) {
    ++n.depth_maps;
    answers.pixels += stored.answers().pixels;
    answers.answered += stored.answers().answered;
    answers.confidence += stored.answers().confidence;
  }
  const auto answered = static_cast<double>(answers.answered);
  if (answers.pixels > 0) n.depth_coverage = answered / static_cast<double>(answers.pixels);
  if (answers.answered > 0) n.depth_confidence = answers.confidence / answered;

  n.vertices = result.mesh.vertices.size();
  n.triangles = result.mesh.triangles.size();
  n.mesh_area = mesh_area(result.mesh);
  return n;
}

MachineInfo machine_info() {
  MachineInfo info;
  info.processor = value_in("/proc/cpuinfo", "model name", ':');
  info.system = value_in("/etc/os-release", "PRETTY_NAME", '=');
  utsname name{};
  if (::uname(&name) == 0) {
    if (!info.system.empty()) info.system += ", ";
    info.system += std::string(name.sysname) + " " + name.release + " " + name.machine;
  }
  info.cores = static_cast<int>(std::thread::hardware_concurrency());
  const long pages = ::sysconf(_SC_PHYS_PAGES), page = ::sysconf(_SC_PAGE_SIZE);
  if (pages > 0 && page > 0) {
    info.memory_bytes = static_cast<std::uint64_t>(pages) * static_cast<std::uint64_t>(page);
  }
  return info;
}

}  // namespace corvid
