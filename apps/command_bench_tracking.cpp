#include <CLI/CLI.hpp>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "apps/command_list.h"
#include "apps/opencl_trouble.h"
#include "apps/program_source.h"
#include "apps/signal_guard.h"
#include "bench/tracking_bench.h"
#include "core/associate.h"
#include "io/atomic_file.h"

namespace corvid {
namespace {

struct TrackingArguments {
  std::vector<std::string> sources;
  std::string device = "auto";
  std::optional<std::string> json;
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
  if (arguments.json) {
    if (auto writable = check_file_writable(*arguments.json); !writable)
      return tl::unexpected(writable.error());
  }
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
  auto device = open_explained([&] { return Device::open(arguments.device); });
  if (!device) return tl::unexpected(device.error());
  TrackingReport report;
  const auto machine = opening_on_device(**device, [&] { return bench_machine(**device); });
  if (!machine) return tl::unexpected(machine.error());
  report.machine = *machine;
  Expected<void> done;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    done = measure(arguments, arguments.sources[i], *sources[i], *device, signals.token(), report);
    if (!done || report.interrupted) break;
  }
  // What was measured is kept, whatever happened after it.
  print(report, context.out);
  if (arguments.json) {
    if (auto written = write_file_atomically(*arguments.json, json_rows(report)); !written)
      return tl::unexpected(written.error());
  }
  if (!done) return tl::unexpected(done.error());
  return report.interrupted ? ExitCode::interrupted : ExitCode::ok;
}

}  // namespace

Action add_bench_tracking(CLI::App& group) {
  auto a = std::make_shared<TrackingArguments>();
  CLI::App* command = group.add_subcommand(
      "tracking", "Time per frame of the tracking frontend, how long its tracks live and drift");
  command->add_option("SOURCE", a->sources, "Recordings, or `synthetic[:key=value,...]`")
      ->required();
  command->add_option("--json", a->json, "File for the rows, as a JSON array");
  command->add_option("--device", a->device, "auto, cpu, gpu, or a number from `corvid doctor`")
      ->envname("CORVID_DEVICE")
      ->capture_default_str();
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
