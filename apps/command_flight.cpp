#include "apps/command_flight.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "apps/evaluation.h"
#include "apps/live_export.h"
#include "apps/opencl_trouble.h"
#include "apps/program_source.h"
#include "apps/progress.h"
#include "apps/report_numbers.h"
#include "apps/run_cut.h"
#include "apps/run_folder.h"
#include "apps/stream_numbers.h"
#include "apps/surface_errors.h"
#include "core/clock.h"
#include "core/log.h"
#include "corvid/engine.h"
#include "io/archive_file.h"
#include "io/mesh_stream.h"
#include "replay/player.h"
#include "replay/synthetic_flight.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

// Hands every event to all who listen.
class Fanout final : public PoseSink, public MeshSink {
 public:
  template <class Sink>
  void add(Sink* sink) {
    poses_.push_back(sink);
    meshes_.push_back(sink);
  }
  void on_pose(const PoseEvent& event) override {
    for (PoseSink* sink : poses_) sink->on_pose(event);
  }
  void add_pose(PoseSink* sink) { poses_.push_back(sink); }
  void add_mesh(MeshSink* sink) { meshes_.push_back(sink); }
  void on_block(const MeshBlock& block) override {
    for (MeshSink* sink : meshes_) sink->on_block(block);
  }
  void on_complete(std::uint64_t version) override {
    for (MeshSink* sink : meshes_) sink->on_complete(version);
  }

 private:
  std::vector<PoseSink*> poses_;
  std::vector<MeshSink*> meshes_;
};

// The part of the true surface that the flight's camera saw well enough for depth: points that lie
// on the depth of three of the frames, evenly picked.
std::function<bool(const Eigen::Vector3d&)> seen_by(const SyntheticFlight& flight) {
  constexpr std::size_t kViews = 40;
  constexpr int kSeenBy = 3;
  constexpr double kTolerance = 0.01;  // of the depth; a pixel of a slanted roof spans about this
  struct View {
    Pose T_camera_world;
    FloatImage depth;
  };
  const std::size_t step = std::max<std::size_t>(1, flight.frame_count() / kViews);
  auto views = std::make_shared<std::vector<View>>();
  for (std::size_t i = 0; i < flight.frame_count(); i += step) {
    views->push_back({flight.true_pose(i).inverse(), flight.render_depth(i)});
  }
  return [views, camera = flight.camera()](const Eigen::Vector3d& p_world) {
    int count = 0;
    for (const View& view : *views) {
      const Eigen::Vector3d p_camera = view.T_camera_world * p_world;
      const auto pixel = camera.project(p_camera);
      if (!pixel || !camera.in_image(*pixel)) continue;
      const double depth = view.depth(static_cast<int>(std::lround(pixel->x())),
                                      static_cast<int>(std::lround(pixel->y())));
      if (depth > 0 && std::abs(p_camera.z() - depth) < kTolerance * depth && ++count >= kSeenBy)
        return true;
    }
    return false;
  };
}

struct Truth {
  std::optional<TrajectoryErrors> trajectory;
  std::optional<SurfaceErrors> surface, cut;
};

Truth compare(const RunResult& result, const SurfaceCut* cut, const FrameSource& source,
              const Trajectory& given) {
  Truth truth;
  const Trajectory poses = given.empty() ? source.truth() : given;
  if (poses.empty()) return truth;
  truth.trajectory = evaluate(result.trajectory, poses);
  if (!truth.trajectory->problem.empty() || (result.mesh.empty() && !cut)) return truth;
  if (const auto surface = source.true_surface()) {
    log().info("comparing the mesh with the true surface");
    SurfaceOptions options;
    if (const auto* flight = dynamic_cast<const SyntheticFlight*>(&source)) {
      options.seen = seen_by(*flight);
    }
    // And two voxels, what a surface of voxels can be asked for.
    const double voxel_m = result.voxel_size * truth.trajectory->T_truth_estimate.scale();
    if (voxel_m > 0) options.completeness_distances_m.push_back(2 * voxel_m);
    const auto errors = [&](const TriangleMesh& mesh) {
      return compare_surfaces(mesh, *surface, truth.trajectory->T_truth_estimate, options);
    };
    if (!result.mesh.empty()) truth.surface = errors(result.mesh);
    if (cut && !cut->mesh.empty()) truth.cut = errors(cut->mesh);
  }
  return truth;
}

// The minimal surface if it was asked for; a note in the result where there can be none.
std::optional<SurfaceCut> cut_if_asked(const FlightPlan& plan, RunResult& result,
                                       const std::stop_token& stop) {
  if (!plan.cut_surface) return {};
  auto cut = cut_run(result, stop);
  if (cut) return std::move(*cut);
  result.interrupted = result.interrupted || cut.error().code == ErrorCode::interrupted;
  const bool instead = !plan.live_surface && !result.mesh.empty();
  result.notes.push_back(fmt::format("No surface by graph cut{}: {}",
                                     instead ? " (the live one is there instead)" : "",
                                     cut.error().to_string()));
  return {};
}

// Why no frame got a pose: the reason that most frames gave.
std::string commonest_reason(const RunResult& result) {
  std::map<std::string, std::size_t> reasons;
  for (const PoseEvent& event : result.events) {
    if (!event.reason.empty()) ++reasons[event.reason];
  }
  std::string best = "the engine gave no reason";
  std::size_t most = 0;
  for (const auto& [reason, count] : reasons) {
    if (count <= most) continue;
    most = count;
    best = fmt::format("{} ({} of {} frames)", reason, count, result.events.size());
  }
  return best;
}

// Positions that were given but belong to no keyframe: most likely the clocks differ.
std::string unmatched(const std::vector<PositionFix>& positions, const RunResult& result) {
  const bool used = std::any_of(result.placements.begin(), result.placements.end(),
                                [](const MapPlacement& p) { return p.positions > 0; });
  if (positions.empty() || used || result.events.empty()) return {};
  std::string note =
      fmt::format("None of the {} positions belongs to a keyframe", positions.size());
  if (!positions.front().frame_name.empty()) return note + ": the names are those of other images.";
  const auto [first, last] =
      std::minmax_element(positions.begin(), positions.end(),
                          [](const auto& a, const auto& b) { return a.time_ns < b.time_ns; });
  return note + fmt::format(": their times are {} to {} ns, the frames' {} to {} ns.",
                            first->time_ns, last->time_ns, result.events.front().time_ns,
                            result.events.back().time_ns);
}

// "metric: ..." or why not, of the segment that the results lie in.
std::string describe_scale(const RunResult& result) {
  if (result.placements.empty()) return "arbitrary: no map";
  const auto most =
      std::max_element(result.placements.begin(), result.placements.end(),
                       [](const MapPlacement& a, const MapPlacement& b) {
                         return std::pair(a.scale, a.positions) < std::pair(b.scale, b.positions);
                       });
  if (most->scale != MapScale::metric) return "arbitrary: " + most->reason;
  return fmt::format(
      "metric, east north up from {:.7f} {:.7f} {:.2f} m; {} of {} positions agree ({:.2f} m "
      "rmse), "
      "scale to {:.2g} %",
      most->origin.latitude_deg, most->origin.longitude_deg, most->origin.altitude_m, most->inliers,
      most->positions, most->rmse_m, 100 * std::sqrt(most->covariance(6, 6)));
}

std::vector<std::string> summary(const RunResult& result, const RunNumbers& n,
                                 const SurfaceCut* cut, const Truth& truth, const fs::path& out) {
  std::vector<std::string> lines;
  const auto row = [&lines](std::string_view name, const std::string& text) {
    lines.push_back(fmt::format("{:<10} {}", name, text));
  };
  row("source", describe(result.source));
  row("frames",
      fmt::format("{} delivered, {} skipped, {} dropped{}", n.delivered, n.skipped, n.dropped,
                  n.lost + n.interruptions == 0
                      ? ""
                      : fmt::format(", {} lost, {} times away", n.lost, n.interruptions)));
  std::string states;
  for (std::size_t i = 0; i < n.states.size(); ++i) {
    states += fmt::format("{}{} {}", i == 0 ? "" : ", ", to_string(static_cast<TrackingState>(i)),
                          n.states[i]);
  }
  row("poses", fmt::format("{} of {} frames ({}; {} untracked after the start)", n.poses, n.events,
                           states, n.untracked_after_start));
  row("map", fmt::format("{} keyframes, {} landmarks, {} segment{}", n.keyframes, n.landmarks,
                         n.segments, n.segments == 1 ? "" : "s"));
  row("scale", describe_scale(result));
  if (const PlaceCounts& p = result.places;
      p.relocalizations + p.loops + p.merges + p.connections + p.refused > 0) {
    row("places", fmt::format("{} relocalized, {} loops closed, {} segments joined, {} more "
                              "recognised, {} refused",
                              p.relocalizations, p.loops, p.merges, p.connections, p.refused));
  }
  if (result.options.mapping.enabled) {
    row("mesh", fmt::format("{} triangles from {} depth maps", n.triangles, n.depth_maps));
  }
  if (truth.trajectory && truth.trajectory->problem.empty()) {
    const TrajectoryErrors& e = *truth.trajectory;
    row("ATE", fmt::format("{:.4f} m over {:.2f} m ({:.3f} % of the length), {} poses, Sim(3)",
                           e.position_m.rmse, e.path_length_m,
                           e.path_length_m > 0 ? 100 * e.position_m.rmse / e.path_length_m : 0.0,
                           e.matched));
  } else if (truth.trajectory) {
    row("ATE", "none: " + truth.trajectory->problem);
  }
  const auto surface_rows = [&row](std::string_view name, const SurfaceErrors& e) {
    if (!e.problem.empty()) {
      row(name, "none: " + e.problem);
      return;
    }
    row(name, fmt::format("median {:.3f} m, 90 % within {:.3f} m of the true surface", e.median_m,
                          e.accuracy90_m));
    std::string within;
    for (std::size_t i = 0; i < e.completeness.size(); ++i) {
      within += fmt::format("{}{:.1f} % within {:.3g} m", i == 0 ? "" : ", ",
                            100 * e.completeness[i], e.completeness_distances_m[i]);
    }
    row("complete", within);
  };
  if (truth.surface) surface_rows("mesh error", *truth.surface);
  if (cut) {
    const SurfaceCutStatistics& s = cut->statistics;
    row("cut", fmt::format("{} triangles; {:.2f} M voxels of {:.3g}, {:.2f} M near points, graph "
                           "{:.2f} s, maximum flow {:.2f} s, {:.0f} MB",
                           cut->mesh.triangles.size(), 1e-6 * static_cast<double>(s.voxels),
                           cut->voxel_size, 1e-6 * static_cast<double>(s.crust_voxels), s.graph_s,
                           s.maxflow_s, 1e-6 * static_cast<double>(s.peak_bytes)));
  }
  if (truth.cut) surface_rows("cut error", *truth.cut);
  row("time", fmt::format("{:.1f} s, {:.1f} frames/s, latency {:.1f} ms (95 %: {:.1f} ms), {:.0f} "
                          "MB, {}",
                          result.wall_s, n.frames_per_s, n.latency_ms.median, n.latency_ms.p95,
                          static_cast<double>(result.peak_memory_bytes) / 1e6, result.device));
  for (const std::string& note : result.notes) row("note", note);
  row("report", (fs::absolute(out) / "report.html").lexically_normal().string());
  return lines;
}

Json end_json(const RunResult& result, const RunNumbers& n, const Truth& truth, const fs::path& out,
              ExitCode code) {
  Json states;
  for (std::size_t i = 0; i < n.states.size(); ++i) {
    states[std::string(to_string(static_cast<TrackingState>(i)))] = n.states[i];
  }
  Json json = {{"event", "end"},
               {"exit_code", static_cast<int>(code)},
               {"interrupted", result.interrupted},
               {"frames", n.events},
               {"poses", n.poses},
               {"states", states},
               {"untracked_after_start", n.untracked_after_start},
               {"source_counts", to_json(result.counts)},
               {"keyframes", n.keyframes},
               {"landmarks", n.landmarks},
               {"segments", n.segments},
               {"scale", result.enu_origin ? "metric" : "arbitrary"},
               {"depth_maps", n.depth_maps},
               {"triangles", n.triangles},
               {"wall_s", result.wall_s},
               {"peak_memory_bytes", result.peak_memory_bytes},
               {"device", result.device},
               {"notes", result.notes},
               {"out", fs::absolute(out).lexically_normal().string()}};
  if (truth.trajectory && truth.trajectory->problem.empty()) {
    const TrajectoryErrors& e = *truth.trajectory;
    json["ate"] = {{"rmse_m", e.position_m.rmse},
                   {"path_length_m", e.path_length_m},
                   {"matched", e.matched},
                   {"scale", e.scale}};
  }
  if (truth.surface && truth.surface->problem.empty()) {
    json["surface"] = {{"median_m", truth.surface->median_m},
                       {"accuracy90_m", truth.surface->accuracy90_m}};
  }
  json["report"] = (fs::absolute(out) / "report.html").lexically_normal().string();
  return json;
}

// @param asked  a signal asked to stop; a run can also end early because its source or device
// failed.
// @param without_cut  the surface by graph cut was asked for, and there is none.
// @param live  a camera, which has no other end than to be stopped.
ExitCode judge(const RunResult& result, const std::string& source, bool asked, bool live,
               bool without_cut) {
  if (result.interrupted && asked && live) {
    if (result.trajectory.empty())
      log().warn("{}: not one frame got a pose: {}", source, commonest_reason(result));
    return ExitCode::ok;
  }
  if (result.interrupted && asked) {
    log().warn("interrupted: this is what there was until then");
    return ExitCode::interrupted;
  }
  if (result.interrupted) {
    log().error("{}: {}", source,
                result.notes.empty() ? "the run ended early" : result.notes.back());
    return ExitCode::failure;
  }
  if (!result.trajectory.empty()) {
    if (without_cut) log().error("{}: {}", source, result.notes.back());
    return without_cut ? ExitCode::no_estimate : ExitCode::ok;
  }
  if (result.counts.delivered == 0) {
    log().error("{}: not one frame could be read ({} skipped; `corvid info --check` says why)",
                source, result.counts.skipped);
    return ExitCode::bad_input;
  }
  log().error("{}: not one frame got a pose: {}", source, commonest_reason(result));
  return ExitCode::no_estimate;
}

}  // namespace

Expected<ExitCode> fly(FlightPlan plan, const SignalGuard& signals, Context& context) {
  if (auto free = check_run_folder(plan.out); !free) return tl::unexpected(free.error());
  if (!plan.engine) {
    auto engine = open_explained([&] { return Engine::create(plan.options); });
    if (!engine) return tl::unexpected(engine.error());
    plan.engine = std::move(*engine);
  }

  SteadyClock clock;
  const FrameSource& source = *plan.source;  // the player owns it from here on
  Player player(std::move(plan.source), clock, plan.rate);
  JsonEvents json(context.out);
  log().info("{}", describe(player.info()));
  for (const std::string& note : player.info().notes) log().info("{}", note);
  if (plan.json) {
    json.write({{"event", "start"},
                {"version", CORVID_VERSION},
                {"source", to_json(player.info())},
                {"rate", plan.rate ? Json(*plan.rate) : Json("max")},
                {"out", fs::absolute(plan.out).lexically_normal().string()}});
  }

  // On the disk that the run goes to anyway.
  auto archive = ArchiveFile::create(fs::absolute(plan.out).lexically_normal().parent_path());
  if (!archive) log().warn("pictures stay in memory: {}", archive.error().to_string());
  PositionFeed own_feed;
  PositionFeed& positions = plan.feed ? *plan.feed : own_feed;
  for (const PositionFix& fix : plan.positions) {
    if (auto pushed = positions.push(fix); !pushed) log().warn("{}", pushed.error().to_string());
  }
  MeshStream stream;
  auto live_export =
      LiveExportServer::start(plan.out, plan.options.mapping.enabled ? &stream : nullptr);
  auto result = [&] {
    Fanout listeners;
    listeners.add_mesh(&stream);
    if (plan.json) listeners.add(&json);
    for (PoseSink* sink : plan.listeners) listeners.add_pose(sink);
    std::optional<ProgressLine> progress;
    if (context.terminal && !context.quiet) {
      progress.emplace(player.info().frames, clock);
      listeners.add(&*progress);
    }
    return plan.engine->run(player, {&listeners, &listeners, archive.value_or(nullptr), plan.map},
                            signals.token(), &positions);
  }();
  if (!result) return tl::unexpected(result.error());
  log_skipped(result->counts);

  std::optional<StreamNumbers> streamed;
  if (!result->mesh.empty() && !plan.brief)
    streamed = count_stream(stream, result->wall_s, plan.options.mapping.stream_bytes_per_s);
  place_on_earth(*result);
  if (const std::string note = unmatched(plan.positions, *result); !note.empty())
    result->notes.push_back(note);
  if (plan.closing_notes)
    for (std::string& note : plan.closing_notes()) result->notes.push_back(std::move(note));
  const auto cut = cut_if_asked(plan, *result, signals.token());
  const SurfaceCut* cut_or_none = cut ? &*cut : nullptr;
  const Truth truth = compare(*result, cut_or_none, source, plan.truth);
  log().info("writing {}", plan.out.string());
  RunReportInput input{*result, truth.trajectory, truth.surface, CORVID_VERSION,
                       context.command_line};
  input.live_surface = plan.live_surface || !cut;
  input.cut = cut_or_none;
  input.cut_errors = truth.cut;
  input.stream = streamed;
  input.brief = plan.brief;
  if (auto written = write_run_folder(input, plan.out); !written) {
    return tl::unexpected(written.error());
  }
  // From here on the folder answers; until then an earlier run's may lie there.
  live_export.reset();

  const SourceInfo& info = player.info();
  const ExitCode code =
      judge(*result, info.kind + " " + info.path, signals.token().stop_requested(), plan.live,
            plan.cut_surface && !cut);
  const RunNumbers numbers = count_run(*result);
  for (const std::string& line : summary(*result, numbers, cut_or_none, truth, plan.out)) {
    if (plan.json) {
      log().info("{}", line);
    } else {
      context.out << line << '\n';
    }
  }
  if (plan.json) json.write(end_json(*result, numbers, truth, plan.out, code));
  return code;
}

}  // namespace corvid
