#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "apps/program.h"
#include "apps/signal_guard.h"
#include "corvid/engine.h"
#include "corvid/options.h"
#include "corvid/ports.h"
#include "corvid/position.h"

namespace corvid {

/// One run of the engine with everything around it: what `replay`, `demo` and `live` have in
/// common.
struct FlightPlan {
  std::unique_ptr<FrameSource> source;  ///< not paced, unless it is a camera
  std::optional<double> rate;           ///< of the player; nothing: as fast as possible
  Options options;
  Trajectory truth;                    ///< instead of the source's own; empty: the source's own
  std::vector<PositionFix> positions;  ///< of the camera on Earth
  bool live_surface = true, cut_surface = false;  ///< which meshes the folder gets; the live one
                                                  ///< stands in for a cut that cannot be
  std::filesystem::path out;
  bool json = false;

  /// A camera: to be stopped is its proper end, and no failure.
  bool live = false;
  std::unique_ptr<Engine> engine;    ///< null: made of the options
  bool brief = false;                ///< RunReportInput::brief, and no count of the mesh stream
  std::vector<PoseSink*> listeners;  ///< besides the program's own; outlive the run
  MapSink* map = nullptr;            ///< outlives the run
  /// Where more positions may come in while it runs; outlives the run.
  PositionFeed* feed = nullptr;
  std::function<std::vector<std::string>()> closing_notes;  ///< for the report, asked at the end
};

/// Runs the source, compares with the truth where there is any, writes the folder and sums up.
/// The folder is written whenever the engine gave a result, even without a pose.
/// @return ok; interrupted; no_estimate or bad_input if not a single pose came out; no_estimate
/// without the cut that was asked for.
[[nodiscard]] Expected<ExitCode> fly(FlightPlan plan, const SignalGuard& signals, Context& context);

}  // namespace corvid
