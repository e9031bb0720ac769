#pragma once

#include <functional>
#include <memory>
#include <stop_token>

#include "corvid/archive.h"
#include "corvid/error.h"
#include "corvid/options.h"
#include "corvid/ports.h"
#include "corvid/run_result.h"

namespace corvid {

/// Who listens. Null pointers are nobody. Sinks must outlive the engine's run.
struct EngineSinks {
  PoseSink* pose = nullptr;
  MeshSink* mesh = nullptr;
  /// Where the pictures of older keyframes go (options.keyframe_images_mb), depth maps and voxels
  /// (options.mapping.memory_mb); null: pictures and depth maps stay in memory, which then grows
  /// with the flight, and voxels beyond the budget are lost. What a run returns reads from it, too.
  std::shared_ptr<Archive> archive = nullptr;
  MapSink* map = nullptr;
};

/// The whole engine: a source goes in; poses, a map and a mesh come out.
///
/// options.threads == 1 runs every stage inline on the caller's thread, so that results repeat
/// bit for bit; otherwise, and always for a paced source, frontend, backend and mapping have a
/// thread each.
class Engine {
 public:
  /// Opens the OpenCL device and builds the kernels. Fails with the list of wrong options, or with
  /// the device's fault.
  [[nodiscard]] static Expected<std::unique_ptr<Engine>> create(const Options& options);
  ~Engine();

  /// Runs the source to its end, or until asked to stop: then what there is comes back, marked as
  /// interrupted. `positions`, if there are any, give the map its scale and its place on Earth;
  /// without them its scale is arbitrary. An error means that the source or the device failed
  /// before any frame had a pose.
  [[nodiscard]] Expected<RunResult> run(FrameSource& source, const EngineSinks& sinks = {},
                                        const std::stop_token& stop = {},
                                        PositionSource* positions = nullptr);

 private:
  struct Impl;
  explicit Engine(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace corvid
