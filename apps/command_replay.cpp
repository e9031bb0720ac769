#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "apps/command_flight.h"
#include "apps/command_list.h"
#include "apps/program_source.h"
#include "apps/signal_guard.h"
#include "io/options_file.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace {

struct Arguments {
  SourceArguments source;
  std::string out, rate = "max", options_file, truth;
  std::optional<std::string> device;
  std::optional<int> threads;
  std::vector<std::string> settings;
  bool no_mapping = false, json = false;
};

Expected<std::optional<double>> parse_rate(const std::string& text) {
  if (text == "max") return std::nullopt;
  double rate = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), rate);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(rate) ||
      rate <= 0) {
    return fail(ErrorCode::invalid_argument, fmt::format("`{}` is not a rate", text), "--rate",
                "max, or a factor of the capture's speed such as 1.0");
  }
  return rate;
}

Expected<Options> resolve(const Arguments& arguments) {
  Options options;
  if (!arguments.options_file.empty()) {
    auto read = read_options_file(arguments.options_file);
    if (!read) return read;
    options = *read;
  }
  for (const std::string& setting : arguments.settings) {
    const std::size_t equals = setting.find('=');
    if (equals == std::string::npos) {
      return fail(ErrorCode::invalid_argument, fmt::format("{} is not KEY=VALUE", setting), "--set",
                  "`corvid options` prints every key");
    }
    auto set = set_option(options, setting.substr(0, equals), setting.substr(equals + 1), "--set");
    if (!set) return tl::unexpected(set.error());
  }
  if (arguments.device) options.device = *arguments.device;
  if (arguments.threads) options.threads = *arguments.threads;
  if (arguments.no_mapping) options.mapping.enabled = false;
  if (auto checked = check_options(options, "options"); !checked) {
    return tl::unexpected(checked.error());
  }
  return options;
}

Expected<ExitCode> run(const Arguments& arguments, Context& context) {
  const SignalGuard signals;
  FlightPlan plan;
  auto rate = parse_rate(arguments.rate);
  if (!rate) return tl::unexpected(rate.error());
  plan.rate = *rate;
  auto options = resolve(arguments);
  if (!options) return tl::unexpected(options.error());
  plan.options = *options;
  if (!arguments.truth.empty()) {
    auto truth = read_trajectory(arguments.truth);
    if (!truth) return tl::unexpected(truth.error());
    plan.truth = std::move(*truth);
  }
  auto source = arguments.source.open();
  if (!source) return tl::unexpected(source.error());
  plan.source = std::move(*source);
  plan.out = arguments.out;
  plan.json = arguments.json;
  return fly(std::move(plan), signals, context);
}

}  // namespace

Action add_replay_command(CLI::App& app) {
  auto a = std::make_shared<Arguments>();
  CLI::App* command =
      app.add_subcommand("replay", "Fly a recording: trajectory, map, mesh and report");
  a->source.add_to(*command);
  command->add_option("--out", a->out, "Folder to write; appears whole at the end")->required();
  command
      ->add_option("--rate", a->rate,
                   "max: as fast as possible, nothing dropped; a number: that many times the "
                   "capture's speed, dropping as live would")
      ->capture_default_str();
  command
      ->add_option("--device", a->device,
                   "OpenCL device: auto, cpu, gpu, or a number from `corvid doctor`")
      ->envname("CORVID_DEVICE");
  command->add_option("--threads", a->threads,
                      "CPU budget; 0: all cores; 1: everything inline, bit-repeatable");
  command->add_option("--options", a->options_file, "Options file (`corvid options` prints one)");
  command
      ->add_option("--set", a->settings,
                   "KEY=VALUE, one option of the engine; wins over the file; may be repeated")
      ->allow_extra_args(false);
  command->add_option("--truth", a->truth,
                      "True trajectory (TUM, KITTI, EuRoC), instead of the source's own");
  command->add_flag("--no-mapping", a->no_mapping, "No depth maps, voxels and mesh");
  command->add_flag("--json", a->json,
                    "One line of JSON per event on the standard output (docs/user-guide.md)");
  command->footer(R"(
Ctrl-C saves what there is and ends with exit code 130.

Examples:
  corvid replay ~/data/MH_05 --out run
  corvid replay photos/ --out run --calibration cam.yaml --device gpu
  corvid replay ~/data/MH_05 --out run --rate 1.0 --set frontend.max_tracks=500
  corvid replay synthetic:seed=3,duration=10,path=orbit --out run --threads 1
)");
  return [a](Context& context) { return run(*a, context); };
}

}  // namespace corvid
