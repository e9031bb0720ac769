#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "corvid/run_result.h"

namespace corvid {

/// Of a set of values: quantiles by the nearest rank; all zero for an empty set.
struct Spread {
  std::size_t count = 0;
  double mean = 0, median = 0, p95 = 0, p99 = 0, max = 0;
};
/// Values that are not finite are left out.
[[nodiscard]] Spread spread_of(std::vector<double> values);

/// What the report and run.json say about a run, counted once for both.
struct RunNumbers {
  std::uint64_t delivered = 0, skipped = 0, dropped = 0, lost = 0, interruptions = 0;
  std::array<std::size_t, 4> states{};  ///< events by TrackingState
  std::size_t events = 0;
  std::size_t with_pose = 0;              ///< events that carry a pose
  std::size_t untracked_after_start = 0;  ///< events without a pose after the first with one
  std::size_t keyframe_events = 0;
  int segments = 0;
  double capture_s = 0;        ///< from the first event to the last
  double start_s = 0;          ///< from the first event to the first pose
  double frames_per_s = 0;     ///< events over wall time
  double realtime_factor = 0;  ///< capture time over wall time; 0 for stills

  std::size_t poses = 0;   ///< of the final trajectory
  double path_length = 0;  ///< [map units]

  std::size_t keyframes = 0, landmarks = 0, observations = 0;
  Spread tracks, inliers, rms_px, latency_ms;

  std::size_t depth_maps = 0;
  double depth_coverage = 0;    ///< mean share of pixels with an answer
  double depth_confidence = 0;  ///< mean over the answers

  std::size_t vertices = 0, triangles = 0;
  double mesh_area = 0;  ///< [map units^2]
};
[[nodiscard]] RunNumbers count_run(const RunResult& result);

/// The computer: processor, cores, memory, operating system; empty strings where unknown.
struct MachineInfo {
  std::string processor, system;
  int cores = 0;
  std::uint64_t memory_bytes = 0;
};
[[nodiscard]] MachineInfo machine_info();

}  // namespace corvid
