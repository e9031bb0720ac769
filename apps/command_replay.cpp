#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/command_flight.h"
#include "apps/command_list.h"
#include "apps/engine_options.h"
#include "apps/program_source.h"
#include "apps/signal_guard.h"
#include "core/log.h"
#include "io/options_file.h"
#include "io/positions_file.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace {

struct Arguments {
  SourceArguments source;
  EngineArguments engine;
  std::string out, rate = "max", truth, positions, surface = "live";
  std::optional<int> threads;
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
  auto options = arguments.engine.read();
  if (!options) return options;
  if (arguments.threads) options->threads = *arguments.threads;
  if (arguments.no_mapping) options->mapping.enabled = false;
  if (auto checked = check_options(*options, "options"); !checked) {
    return tl::unexpected(checked.error());
  }
  if (arguments.surface != "live" && !options->mapping.enabled) {
    return fail(ErrorCode::invalid_argument, "there are no depth maps to cut it from",
                "--surface " + arguments.surface,
                "leave out --no-mapping (mapping.enabled = false)");
  }
  return options;
}

/// What --positions asks for; without it, what came with the images.
Expected<std::vector<PositionFix>> positions_of(const std::string& asked,
                                                const FrameSource& source) {
  if (asked == "none") return std::vector<PositionFix>{};
  if (asked.empty()) return source.positions();
  auto file = read_positions(asked);
  if (!file) return tl::unexpected(file.error());
  log().info("{}: {} positions{}", asked, file->fixes.size(),
             file->without_fix > 0 ? fmt::format(", {} rows without one", file->without_fix) : "");
  return std::move(file->fixes);
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
  auto positions = positions_of(arguments.positions, **source);
  if (!positions) return tl::unexpected(positions.error());
  plan.positions = std::move(*positions);
  plan.source = std::move(*source);
  plan.live_surface = arguments.surface != "cut";
  plan.cut_surface = arguments.surface != "live";
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
  a->engine.add_to(*command);
  command->add_option("--threads", a->threads,
                      "CPU budget; 0: all cores; 1: everything inline, bit-repeatable");
  command->add_option("--truth", a->truth,
                      "True trajectory (TUM, KITTI, EuRoC), instead of the source's own");
  command->add_option("--positions", a->positions,
                      "GNSS positions of the camera, csv (docs/formats.md): the map gets its scale "
                      "and place on Earth; none: not even those in the images' EXIF");
  command
      ->add_option("--surface", a->surface,
                   "Mesh files to write: live: the surface fused while flying; cut: the minimal "
                   "surface of all depth maps, closed, cut at the end; or both")
      ->capture_default_str()
      ->check(CLI::IsMember({"live", "cut", "both"}));
  command->add_flag("--no-mapping", a->no_mapping, "No depth maps, voxels and mesh");
  command->add_flag("--json", a->json,
                    "One line of JSON per event on the standard output (docs/user-guide.md)");
  command->footer(R"(
Ctrl-C saves what there is and ends with exit code 130.

Examples:
  corvid replay ~/data/MH_05 --out run
  corvid replay photos/ --out run --calibration cam.yaml --device gpu
  corvid replay ~/data/MH_05 --out run --rate 1.0 --set frontend.max_tracks=500
  corvid replay ~/flights/12 --out run --positions gnss.csv
  corvid replay synthetic:seed=3,duration=10,path=orbit --out run --threads 1
)");
  return [a](Context& context) { return run(*a, context); };
}

}  // namespace corvid
