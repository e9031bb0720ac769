#include "corvid/engine.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <exception>
#include <opencv2/core/utility.hpp>
#include <thread>
#include <utility>

#include "backend/backend.h"
#include "core/clock.h"
#include "core/log.h"
#include "core/stopwatch.h"
#include "engine/gate.h"
#include "engine/image_store.h"
#include "engine/in_order.h"
#include "engine/latest.h"
#include "engine/metrics.h"
#include "engine/queue.h"
#include "engine/queue_brake.h"
#include "frontend/frontend.h"
#include "frontend/place_finder.h"
#include "kernels/device.h"
#include "mapping/mapper.h"

namespace corvid {
namespace {

struct TimedFrame {
  FramePtr frame;
  std::int64_t entered_ns = 0;
  Gate::Turn turn{};  ///< ends with the frame's pose, or when it is dropped
};
struct TimedTracks {
  FrameTracks tracks;
  std::int64_t entered_ns = 0;
  Gate::Turn turn{};
};

/// The backend's newest state for the frontend. Rejected tracks of states that the frontend never
/// saw are carried over, so that none is lost.
class MotionMailbox {
 public:
  void publish(std::shared_ptr<const MotionState> state) {
    const std::lock_guard lock(mutex_);
    pending_.insert(pending_.end(), state->rejected.begin(), state->rejected.end());
    newest_ = std::move(state);
  }
  [[nodiscard]] std::shared_ptr<const MotionState> take() {
    const std::lock_guard lock(mutex_);
    if (!newest_ || newest_->rejected == pending_) {
      pending_.clear();
      return newest_;
    }
    auto merged = std::make_shared<MotionState>(*newest_);
    merged->rejected = std::exchange(pending_, {});
    return merged;
  }

 private:
  std::mutex mutex_;
  std::shared_ptr<const MotionState> newest_;
  std::vector<TrackId> pending_;
};

/// A frame to be looked for, and the map in which.
struct PlaceQuery {
  FrameTracks tracks;
  std::shared_ptr<const MapSnapshot> map;
};

/// What was recognised, on its way to the backend.
class PlaceMailbox {
 public:
  void put(PlaceMatch match) {
    const std::lock_guard lock(mutex_);
    matches_.push_back(std::move(match));
  }
  [[nodiscard]] std::vector<PlaceMatch> take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(matches_, {});
  }

 private:
  std::mutex mutex_;
  std::vector<PlaceMatch> matches_;
};

}  // namespace

struct Engine::Impl {
  Options options;
  std::shared_ptr<Device> device;
  int threads = 1;

  /// One run's stages and what they share.
  struct Run {
    Impl& engine;
    FrameSource& source;
    InOrder intake;  // of the source
    EngineSinks sinks;
    PositionSource* positions;  // null if there are none
    Gate& gate;
    std::unique_ptr<Frontend> frontend;
    std::unique_ptr<Backend> backend;
    std::unique_ptr<Mapper> mapper;       // null if mapping is off
    std::unique_ptr<PlaceFinder> finder;  // null if places are not recognised
    SteadyClock clock;
    Metrics metrics;
    MotionMailbox motion;
    Latest<MapSnapshot> map;
    Latest<PlaceQuery> place_query;  // the newest counts
    PlaceMailbox recognised;
    ImageStore images;
    RunResult result;
    double& held_ms;  // that mapping has waited at the gate; of the thread that maps

    // Each stage is a plain function; the two ways to run them are below.
    [[nodiscard]] FrameTracks track(const FramePtr& frame);
    void estimate(const TimedTracks& tracks);
    bool recognise();
    void find_place(const PlaceQuery& query);
    bool map_once(const MapSnapshot& snapshot);

    std::optional<Error> run_inline(const std::stop_token& stop);
    std::optional<Error> run_threads(const std::stop_token& stop);
    void finish(bool interrupted, const std::stop_token& stop);
  };
};

Engine::Engine(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Engine::~Engine() = default;

Expected<std::unique_ptr<Engine>> Engine::create(const Options& options) {
  if (const auto problems = options.validate(); !problems.empty())
    return fail(ErrorCode::invalid_argument, fmt::format("{}", fmt::join(problems, "; ")),
                "options", "`corvid options` lists every option with its range");
  auto impl = std::make_unique<Impl>();
  impl->options = options;
  const int cores = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  impl->threads = options.threads > 0 ? options.threads : cores;
  auto device = Device::open(options.device, impl->threads);
  if (!device) return tl::unexpected(device.error());
  impl->device = std::move(*device);
  return std::unique_ptr<Engine>(new Engine(std::move(impl)));
}

FrameTracks Engine::Impl::Run::track(const FramePtr& frame) {
  if (!frame->blind.empty()) return {frame, false, {}};
  Stopwatch watch;
  const auto state = motion.take();
  FrameTracks tracks = frontend->process(frame, state.get());
  metrics.add("frontend", watch.lap_ms());
  metrics.add(frontend->last_timings_ms());
  const FrontendCounts& counts = frontend->last_counts();
  log().debug(
      "frame {}: {} tracks sought, {} found, {} recovered, {} outliers, {} merged, {} new{}",
      frame->id.value, counts.before, counts.found, counts.recovered, counts.epipolar_outliers,
      counts.merged, counts.added, tracks.keyframe ? ", keyframe" : "");
  return tracks;
}

void Engine::Impl::Run::estimate(const TimedTracks& timed) {
  Stopwatch watch;
  if (positions) backend->add_positions(positions->take());
  const bool moved = recognise();
  PoseEvent event = backend->add(timed.tracks);
  metrics.add("backend", watch.lap_ms());
  metrics.add(backend->last_timings_ms());
  motion.publish(backend->motion());
  if (timed.tracks.keyframe || moved) {
    map.publish(backend->map());
    if (sinks.map) sinks.map->on_map(backend->map());
  }
  if (const auto& query = backend->place_query(); query && finder)
    place_query.publish(std::make_shared<PlaceQuery>(PlaceQuery{*query, backend->map()}));
  if (timed.tracks.frame->blind.empty()) {
    event.latency_ms = static_cast<double>(clock.now_ns() - timed.entered_ns) * 1e-6;
    metrics.add("latency", event.latency_ms);
  }
  log().debug("frame {}: {}{}{}, {} of {} tracks agree, {:.3f} px^2", event.frame.value,
              to_string(event.state), event.reason.empty() ? "" : ": ", event.reason, event.inliers,
              event.tracks, event.mse_px2);
  if (sinks.pose) sinks.pose->on_pose(event);
  result.events.push_back(std::move(event));
}

/// Hands what was recognised since the last frame to the backend; whether there was anything.
bool Engine::Impl::Run::recognise() {
  const auto matches = recognised.take();
  for (const PlaceMatch& match : matches) {
    backend->recognise(match);
    metrics.add(backend->last_timings_ms());
  }
  return !matches.empty();
}

void Engine::Impl::Run::find_place(const PlaceQuery& query) {
  Stopwatch watch;
  PlaceSearch search = finder->find(query.tracks, *query.map);
  metrics.add("place", watch.lap_ms());
  metrics.add(finder->last_timings_ms());
  for (const std::string& refusal : search.refusals)
    log().debug("frame {} is not the place of {}", query.tracks.frame->id.value, refusal);
  if (search.match.references.empty()) return;
  for (const PlaceReference& reference : search.match.references)
    log().debug("frame {} shows {} landmarks ({:.0f} %) of frame {}, similarity {:.2f}",
                query.tracks.frame->id.value, reference.views.size(), 100 * reference.share,
                reference.keyframe.value, reference.similarity);
  recognised.put(std::move(search.match));
}

bool Engine::Impl::Run::map_once(const MapSnapshot& snapshot) {
  Stopwatch watch;
  held_ms = 0;
  const bool worked = mapper->step(snapshot);
  if (worked) {
    metrics.add("mapping", watch.lap_ms() - held_ms);
    if (source.info().paced) metrics.add("mapping/held", held_ms);
    for (const auto& [part, ms] : mapper->last_timings()) metrics.add("mapping/" + part, ms);
  }
  return worked;
}

std::optional<Error> Engine::Impl::Run::run_inline(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    auto frame = intake.next(stop);
    if (!frame) return frame.error();
    if (!*frame) break;
    const std::int64_t entered_ns = clock.now_ns();
    const TimedTracks tracks{track(*frame), entered_ns};
    estimate(tracks);
    if (finder && backend->place_query()) find_place(*place_query.get());
    if (const auto snapshot = map.get()) images.trim(*snapshot);
    if (mapper && tracks.tracks.keyframe)
      while (!stop.stop_requested() && map_once(*map.get())) {
      }
  }
  return std::nullopt;
}

std::optional<Error> Engine::Impl::Run::run_threads(const std::stop_token& stop) {
  const bool live = source.info().paced;
  BoundedQueue<TimedFrame> frames(live ? 3 : 2,
                                  live ? QueuePolicy::drop_oldest : QueuePolicy::block);
  BoundedQueue<TimedTracks> tracks(1, QueuePolicy::block);

  std::mutex failure_mutex;
  std::optional<Error> source_error;
  std::exception_ptr exception;
  std::stop_source halt;
  const std::stop_callback forward(stop, [&] { halt.request_stop(); });
  const std::stop_token halted = halt.get_token();
  const std::stop_callback open_gate(halted, [&] { gate.open(); });
  // A stage that throws stops the others; the first exception comes out below.
  const auto guarded = [&](auto&& stage) {
    try {
      stage();
    } catch (...) {
      const std::lock_guard lock(failure_mutex);
      if (!exception) exception = std::current_exception();
      halt.request_stop();
    }
  };

  {
    std::jthread capture([&] {
      guarded([&] {
        while (!halted.stop_requested()) {
          auto frame = intake.next(halted);
          if (!frame) {
            source_error = frame.error();
            break;
          }
          if (!*frame) break;
          TimedFrame timed{std::move(*frame), clock.now_ns()};
          if (live && (mapper || finder)) timed.turn = gate.enter();
          if (!frames.push(std::move(timed), halted)) break;
        }
      });
      frames.close();
    });
    std::jthread frontend_stage([&] {
      guarded([&] {
        while (auto timed = frames.pop(halted))
          if (!tracks.push({track(timed->frame), timed->entered_ns, std::move(timed->turn)},
                           halted))
            break;
      });
      tracks.close();
    });
    std::jthread backend_stage([&] {
      guarded([&] {
        while (auto timed = tracks.pop(halted)) estimate(*timed);
      });
      map.close();
      place_query.close();
    });
    std::jthread place_stage([&] {
      if (!finder) return;
      guarded([&] {
        std::uint64_t seen = 0;
        while (const auto query = place_query.wait(seen, halted)) find_place(*query);
      });
    });
    std::jthread trimming([&] {
      guarded([&] {
        std::uint64_t seen = 0;
        while (const auto snapshot = map.wait(seen, halted)) images.trim(*snapshot);
      });
    });
    std::jthread mapping_stage([&] {
      if (!mapper) return;
      guarded([&] {
        std::uint64_t seen = 0;
        while (auto snapshot = map.wait(seen, halted))
          while (!halted.stop_requested() && map_once(*snapshot)) snapshot = map.get();
      });
    });
  }
  result.counts.dropped = frames.dropped();
  if (exception) std::rethrow_exception(exception);
  return source_error;
}

void Engine::Impl::Run::finish(bool interrupted, const std::stop_token& stop) {
  Stopwatch watch;
  if (positions) backend->add_positions(positions->take());
  if (!interrupted) {
    recognise();
    if (!backend->finish(stop)) {
      interrupted = true;
      result.notes.emplace_back(
          "The adjustment of the whole map was stopped before its end: the poses are what it had "
          "reached by then.");
    }
    metrics.add("backend/finish", watch.lap_ms());
  }
  result.map = backend->map();
  result.trajectory = backend->trajectory();
  result.trajectory_segments = backend->trajectory_segments();
  result.placements = backend->placements();
  result.places = backend->places();
  if (mapper) {
    if (!interrupted) {
      log().info("mapping: finishing what is left of {} keyframes", result.map->keyframes.size());
      mapper->finish(*result.map, stop);
      metrics.add("mapping/finish", watch.lap_ms());
      interrupted = stop.stop_requested();
    }
    result.mesh = mapper->mesh();
    result.voxel_size = mapper->voxel_size();
    result.depth_maps = mapper->depth_maps(*result.map);
    const MapperStatistics statistics = mapper->statistics();
    result.notes.push_back(fmt::format(
        "Mapping: {} depth maps ({:.0f} % of the rays answered), {} keyframes without an "
        "answer, {} that show what was mapped before, {} fused anew after their pose moved, {} "
        "voxel blocks, {} of them in memory.",
        statistics.depth_maps, 100 * statistics.answered, statistics.without_depth,
        statistics.skipped, statistics.refusions, statistics.blocks, statistics.blocks_in_memory));
    if (statistics.depth_maps > 0 && result.mesh.empty())
      result.notes.push_back(fmt::format(
          "The depth maps made no surface: most likely voxels of {:.3g} map units do not fit the "
          "scene; `mapping.voxel_size = 0` chooses a size that does.",
          result.voxel_size));
    if (statistics.lost_depth_maps > 0)
      result.notes.push_back(fmt::format(
          "{} depth maps could not be read back from the archive: their surface stays where it "
          "was fused last.",
          statistics.lost_depth_maps));
    if (statistics.lost_blocks > 0)
      result.notes.push_back(fmt::format(
          "{} voxel blocks were lost for want of room: mapping.memory_mb = {}, mapping.disk_mb = "
          "{}.",
          statistics.lost_blocks, engine.options.mapping.memory_mb,
          engine.options.mapping.disk_mb));
  }
  if (images.failure())
    result.notes.push_back(
        "Keyframes' pictures stayed in memory when they could not be put away: " +
        images.failure()->to_string());
  const std::uint64_t dropped = result.counts.dropped;
  result.counts = intake.counts();
  result.counts.dropped += dropped;
  result.counts.delivered -= std::min(result.counts.delivered, dropped);  // never reached a stage
  result.interrupted = interrupted;
  result.stages = metrics.summary();
  result.peak_memory_bytes = peak_memory_bytes();
}

Expected<RunResult> Engine::run(FrameSource& source, const EngineSinks& sinks,
                                const std::stop_token& stop, PositionSource* positions) {
  const SourceInfo& info = source.info();
  cv::setNumThreads(impl_->threads);
  auto frontend = Frontend::create(impl_->device, impl_->options.frontend, info.stills,
                                   impl_->options.matching);
  if (!frontend) return tl::unexpected(frontend.error());
  // In a paced run tracking goes before mapping, on the device and on the host.
  QueueBrake brake(impl_->device, Lane::mapping);
  Gate gate(&brake);
  double held_ms = 0;
  std::unique_ptr<Mapper> mapper;
  if (impl_->options.mapping.enabled) {
    auto created =
        Mapper::create(impl_->device, impl_->options.mapping, sinks.mesh, sinks.archive, [&] {
          Stopwatch watch;
          gate.wait();
          held_ms += watch.lap_ms();
        });
    if (!created) return tl::unexpected(created.error());
    mapper = std::move(*created);
  }
  std::unique_ptr<PlaceFinder> finder;
  if (impl_->options.place.enabled) {
    auto created = PlaceFinder::create(impl_->device, impl_->options.place, impl_->options.matching,
                                       [&] { gate.wait(); });
    if (!created) return tl::unexpected(created.error());
    finder = std::move(*created);
  }
  auto backend = std::make_unique<Backend>(impl_->options.backend, info.intrinsics, impl_->threads);
  Impl::Run run{
      *impl_,
      source,
      InOrder(source),
      sinks,
      positions,
      gate,
      std::move(*frontend),
      std::move(backend),
      std::move(mapper),
      std::move(finder),
      {},
      {},
      {},
      {},
      {},
      {},
      ImageStore(sinks.archive, static_cast<std::size_t>(impl_->options.keyframe_images_mb) << 20),
      {},
      held_ms};
  run.result.options = impl_->options;
  run.result.device = impl_->device->info().name;
  run.result.source = info;

  const std::int64_t begin_ns = run.clock.now_ns();
  std::optional<Error> error;
  try {
    // A paced source needs a thread of its own: frames come whether the engine is ready or not.
    error = impl_->threads == 1 && !info.paced ? run.run_inline(stop) : run.run_threads(stop);
    run.finish(stop.stop_requested() || error.has_value(), stop);
  } catch (const DeviceFault& fault) {
    error = Error{ErrorCode::device, fault.what(), impl_->device->info().name,
                  "run `corvid doctor`; `--device cpu` uses the processor instead"};
    run.finish(true, stop);  // what was mapped before lies on the host and is kept
  }
  if (error) {
    if (run.result.trajectory.empty()) return tl::unexpected(*error);
    run.result.notes.push_back("The run ended early: " + error->to_string());
  }
  run.result.wall_s = static_cast<double>(run.clock.now_ns() - begin_ns) * 1e-9;
  return std::move(run.result);
}

}  // namespace corvid
