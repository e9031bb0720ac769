#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "bench/tracking_report.h"
#include "core/stopwatch.h"
#include "core/tracks.h"
#include "corvid/error.h"
#include "corvid/options.h"
#include "corvid/ports.h"
#include "frontend/frontend.h"
#include "kernels/device.h"

namespace corvid {

/// What the frontend said and took, frame by frame.
struct TrackingRun {
  struct Step {
    std::int64_t time_ns = 0;
    bool keyframe = false;
    std::vector<TrackObservation> observations;
    double wall_ms = 0, cpu_ms = 0;
    Timings parts_ms;
    FrontendCounts counts;
  };
  std::string set;
  int max_tracks = 0;
  Camera camera;
  std::vector<Step> frames;
  bool interrupted = false;
};

/// Frontend and backend in turn over the frames of a source, so that a run repeats; the backend on
/// all cores, as in live use. Only Frontend::process() is timed.
/// Errors: of the source; device; invalid_argument.
[[nodiscard]] Expected<TrackingRun> run_tracking_bench(const std::shared_ptr<Device>& device,
                                                       FrameSource& source,
                                                       const FrontendOptions& frontend_options,
                                                       const std::stop_token& stop);

/// @param T_world_camera  true pose of each frame of the run where there is one; may be empty.
[[nodiscard]] TrackingRow score_tracking(const TrackingRun& run,
                                         const std::vector<std::optional<Pose>>& T_world_camera);

}  // namespace corvid
