#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <vector>

#include "apps/bench_output.h"
#include "apps/command_list.h"
#include "apps/program_source.h"
#include "apps/signal_guard.h"
#include "bench/tracking_bench.h"
#include "core/associate.h"

namespace corvid {
namespace {

struct TrackingArguments {
  std::vector<std::string> sources;
  BenchOutput output;
  int tracks = 1000, count = -1;
};

Expected<void> measure(const TrackingArguments& arguments, const std::string& spec,
                       FrameSource& source, const std::shared_ptr<Device>& device,
                       const std::stop_token& stop, TrackingReport& report) {
  FrontendOptions options;
  options.max_tracks = arguments.tracks;
  auto run = run_tracking_bench(device, source, options, stop);
  if (!run) return tl::unexpected(run.error());
  run->set = spec;
  report.interrupted = run->interrupted;
  std::vector<std::int64_t> times_ns;
  for (const auto& frame : run->frames) times_ns.push_back(frame.time_ns);
  report.rows.push_back(score_tracking(*run, true_poses(times_ns, source.truth())));
  return {};
}

Expected<ExitCode> run_tracking(const TrackingArguments& arguments, Context& context) {
  if (auto writable = arguments.output.check(); !writable) return tl::unexpected(writable.error());
  std::vector<std::unique_ptr<FrameSource>> sources;  // opened before minutes of measuring
  for (const std::string& spec : arguments.sources) {
    SourceArguments source_arguments{spec, {}};
    source_arguments.options.colour = false;
    source_arguments.options.count = arguments.count;
    auto source = source_arguments.open();
    if (!source) return tl::unexpected(source.error());
    sources.push_back(std::move(*source));
  }
  const SignalGuard signals;
  auto device = arguments.output.open_device();
  if (!device) return tl::unexpected(device.error());
  TrackingReport report;
  const auto machine = bench_machine(**device);
  if (!machine) return tl::unexpected(machine.error());
  report.machine = *machine;
  Expected<void> done;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    done = measure(arguments, arguments.sources[i], *sources[i], *device, signals.token(), report);
    if (!done || report.interrupted) break;
  }
  return arguments.output.keep(report, done, context);
}

}  // namespace

Action add_bench_tracking(CLI::App& group) {
  auto a = std::make_shared<TrackingArguments>();
  CLI::App* command = group.add_subcommand(
      "tracking", "Time per frame of the tracking frontend, how long its tracks live and drift");
  command->add_option("SOURCE", a->sources, "Recordings, or `synthetic[:key=value,...]`")
      ->required();
  a->output.add_to(*command);
  command->add_option("--tracks", a->tracks, "Features kept alive per frame")
      ->check(CLI::Range(10, 100000))
      ->capture_default_str();
  command->add_option("--count", a->count, "Frames taken of each source; all if not given")
      ->check(CLI::Range(1, 1000000000));
  command->footer(R"(
Frontend and backend run in turn over every frame; only the frontend is timed. Where a source has
true poses, tracks are compared with them.

Examples:
  corvid bench tracking euroc/MH_05 kitti/07 synthetic --json tracking.json
)");
  return [a](Context& context) { return run_tracking(*a, context); };
}

}  // namespace corvid
