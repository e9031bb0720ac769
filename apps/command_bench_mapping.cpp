#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <string>
#include <system_error>
#include <vector>

#include "apps/bench_output.h"
#include "apps/command_list.h"
#include "apps/mapping_scenes.h"
#include "apps/program_source.h"
#include "apps/signal_guard.h"
#include "bench/mapping_bench.h"
#include "core/log.h"

namespace corvid {
namespace {

struct MappingArguments {
  std::vector<std::string> sources;
  BenchOutput output;
  int runs = 5, step = 5, count = 30;
};

constexpr const char* kFlight = "synthetic:width=640,height=480,duration=4";
constexpr int kLiveDepths = 128;
constexpr double kFewVoxels = 3.1e6, kManyVoxels = 18.9e6;  ///< of the thesis's table

struct Opened {
  std::string name;
  std::unique_ptr<FrameSource> source;
};

Expected<std::vector<Opened>> open_all(const MappingArguments& arguments) {
  std::vector<std::string> specs{kFlight};
  specs.insert(specs.end(), arguments.sources.begin(), arguments.sources.end());
  std::vector<Opened> out;
  for (const std::string& spec : specs) {
    SourceArguments source_arguments{spec, {}};
    source_arguments.options.colour = false;
    auto source = source_arguments.open();
    if (!source) return tl::unexpected(source.error());
    std::error_code error;
    const auto path = std::filesystem::canonical(spec, error);
    out.push_back({error ? spec : path.filename().string(), std::move(*source)});
  }
  return out;
}

/// The timed works of a scene: a ray per pixel where there is true depth, the thesis's numbers of
/// rays where there is a volume.
std::vector<DepthWork> works_of(const MappingScene& scene, bool live,
                                const std::optional<Eigen::AlignedBox3d>& volume) {
  std::vector<DepthWork> works;
  const std::size_t middle = scene.views.size() / 2;
  if (live) works.push_back({"live, " + scene.name, &scene, middle, {}, 0, kLiveDepths});
  if (volume) {
    for (const double rays : {77690.0, 256894.0})
      works.push_back({"volume, " + scene.name, &scene, middle, *volume, rays, 0});
  }
  return works;
}

Expected<void> measure(const MappingArguments& arguments, std::vector<Opened>& opened,
                       const std::shared_ptr<Device>& device, const std::stop_token& stop,
                       MappingReport& report) {
  auto peak = PeakMeter::create(device);
  if (!peak) return tl::unexpected(peak.error());
  std::vector<MappingScene> scenes;
  scenes.reserve(opened.size());
  std::vector<DepthWork> works;
  std::vector<const MappingScene*> with_truth;
  std::vector<std::pair<const MappingScene*, Eigen::AlignedBox3d>> with_volume;
  for (Opened& o : opened) {
    const bool stills = o.source->info().stills;
    log().info("reading {}", o.name);
    auto scene = read_mapping_scene(*o.source, stills ? 1 : arguments.step,
                                    stills ? 1000 : arguments.count, stop);
    if (!scene) return tl::unexpected(scene.error());
    scene->name = o.name;
    scenes.push_back(std::move(*scene));
    const bool is_flight = &o == &opened.front();
    if (has_true_depth(scenes.back())) with_truth.push_back(&scenes.back());
    const auto volume = middlebury_box(o.source->info().path);
    if (volume) with_volume.emplace_back(&scenes.back(), *volume);
    for (DepthWork& work : works_of(scenes.back(), is_flight, volume))
      works.push_back(std::move(work));
  }
  if (auto timed = time_depth(device, *peak, works, arguments.runs, stop, report); !timed)
    return timed;
  for (const auto& [scene, volume] : with_volume) {
    if (report.interrupted) break;
    auto cut = time_snapshots(device, *scene, volume, {kFewVoxels, kManyVoxels}, arguments.runs,
                              stop, report);
    if (!cut) return cut;
  }
  for (const MappingScene* scene : with_truth) {
    if (report.interrupted) break;
    auto row = score_mapping(device, *scene, stop);
    if (!row) return tl::unexpected(row.error());
    if (*row) report.rows.push_back(**row);
    report.interrupted = stop.stop_requested();
  }
  return {};
}

Expected<ExitCode> run_mapping(const MappingArguments& arguments, Context& context) {
  if (auto writable = arguments.output.check(); !writable) return tl::unexpected(writable.error());
  auto opened = open_all(arguments);  // before minutes of measuring
  if (!opened) return tl::unexpected(opened.error());
  const SignalGuard signals;
  auto device = arguments.output.open_device();
  if (!device) return tl::unexpected(device.error());
  MappingReport report;
  const auto machine = bench_machine(**device);
  if (!machine) return tl::unexpected(machine.error());
  report.machine = *machine;
  const auto done = measure(arguments, *opened, *device, signals.token(), report);
  return arguments.output.keep(report, done, context);
}

}  // namespace

Action add_bench_mapping(CLI::App& group) {
  auto a = std::make_shared<MappingArguments>();
  CLI::App* command = group.add_subcommand("mapping",
                                           "Time and accuracy of depth maps and of the surface by "
                                           "graph cut, against the machine's peak");
  command->add_option("SOURCE", a->sources,
                      "With true poses: recordings with depth images (7-Scenes), Middlebury stills "
                      "(their volume), or `synthetic[:key=value,...]`");
  a->output.add_to(*command);
  command->add_option("--runs", a->runs, "Runs of each work, of which the median time counts")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command->add_option("--step", a->step, "Every so many frames of a video are a view")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command->add_option("--count", a->count, "Views taken of a video at most")
      ->check(CLI::Range(5, 1000))
      ->capture_default_str();
  command->footer(R"(
Always measured: a depth map of a synthetic flight at 640x480 with 4 neighbours and 128 depths, and
its accuracy. A Middlebury set gives the rays of the thesis's table through its bounding box, and
the surface in it by graph cut at the thesis's numbers of voxels.

Examples:
  corvid bench mapping templeRing redkitchen --json mapping.json
)");
  return [a](Context& context) { return run_mapping(*a, context); };
}

}  // namespace corvid
