#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <memory>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "apps/bench_output.h"
#include "apps/command_list.h"
#include "apps/program_source.h"
#include "apps/signal_guard.h"
#include "bench/matching/matching_bench.h"
#include "bench/ncc_bench.h"
#include "core/log.h"

namespace corvid {
namespace {

struct NccArguments {
  BenchOutput output;
  std::vector<int> templates_px, images_px;
  std::vector<std::string> tables;
  int runs = 0;
  bool quick = false;

  [[nodiscard]] NccBenchOptions options() const {
    NccBenchOptions options;
    if (quick) {
      options.images_px = {250, 500, 1024};
      options.runs = 3;
    }
    if (!templates_px.empty()) options.templates_px = templates_px;
    if (!images_px.empty()) options.images_px = images_px;
    if (runs > 0) options.runs = runs;
    if (!tables.empty()) {
      options.tables.clear();
      for (const NccTable table : kNccTables) {
        if (std::find(tables.begin(), tables.end(), to_string(table)) != tables.end())
          options.tables.push_back(table);
      }
    }
    return options;
  }
};

Expected<ExitCode> run_ncc(const NccArguments& arguments, Context& context) {
  const NccBenchOptions options = arguments.options();
  if (auto valid = validate(options); !valid) {
    Error error = valid.error();
    error.hint = "`corvid bench ncc --help` shows what is possible";
    return tl::unexpected(std::move(error));
  }
  if (auto writable = arguments.output.check(); !writable) return tl::unexpected(writable.error());
  const SignalGuard signals;
  auto device = arguments.output.open_device();
  if (!device) return tl::unexpected(device.error());
  NccReport report;
  const auto done = run_ncc_bench(*device, options, signals.token(), report);
  const auto kept = arguments.output.keep(report, done, context);
  if (!kept) return kept;
  const std::vector<std::string> wrong = disagreements(report);
  for (const std::string& sentence : wrong) log().error("{}", sentence);
  return wrong.empty() ? kept : ExitCode::failure;
}

Action add_ncc(CLI::App& group) {
  auto a = std::make_shared<NccArguments>();
  CLI::App* command = group.add_subcommand(
      "ncc", "Normalized cross-correlation against OpenCV and against the machine's peak");
  const NccBenchOptions defaults;
  std::vector<std::string> tables;
  for (const NccTable table : kNccTables) tables.emplace_back(to_string(table));
  a->output.add_to(*command);
  command->add_flag("--quick", a->quick, "3 runs, images up to 1024 px");
  command->add_option("--runs", a->runs, fmt::format("Runs of each work [{}]", defaults.runs))
      ->check(CLI::Range(1, 10000));
  command->add_option("--tables", a->tables, "Only these, separated by commas")
      ->delimiter(',')
      ->check(CLI::IsMember(tables));
  command
      ->add_option("--templates", a->templates_px,
                   fmt::format("Sides of the dense table's templates [px] [{}]",
                               fmt::join(defaults.templates_px, ",")))
      ->delimiter(',');
  command
      ->add_option("--images", a->images_px,
                   fmt::format("Sides of the dense table's images [px] [{}]",
                               fmt::join(defaults.images_px, ",")))
      ->delimiter(',');
  command->footer(R"(
Takes some minutes. Ctrl-C ends it; what was measured until then is printed and written.
Exit code 1 if a coefficient is not what OpenCV computes.

Examples:
  corvid bench ncc --json ncc.json
  corvid bench ncc --quick --tables dense --templates 11 --images 1024
)");
  return [a](Context& context) { return run_ncc(*a, context); };
}

struct MatchingArguments {
  std::vector<std::string> sources;
  SourceArguments reading;
  MatchingBenchOptions options;
  BenchOutput output;
};

// The folder's or file's own name; the whole of `synthetic:...`.
std::string set_name(const std::string& spec) {
  std::error_code error;
  if (!std::filesystem::exists(spec, error)) return spec;
  const auto path = std::filesystem::canonical(spec, error);
  return error || path.filename().empty() ? spec : path.filename().string();
}

Expected<ExitCode> run_matching(const MatchingArguments& arguments, Context& context) {
  if (auto writable = arguments.output.check(); !writable) return tl::unexpected(writable.error());
  std::vector<MatchingSet> sets;  // opened before minutes of measuring
  for (const std::string& spec : arguments.sources) {
    SourceArguments one = arguments.reading;
    one.spec = spec;
    one.options.colour = false;
    auto source = one.open();
    if (!source) return tl::unexpected(source.error());
    log().info("{}", describe((*source)->info()));
    sets.push_back({set_name(spec), std::move(*source)});
  }
  const SignalGuard signals;
  auto device = arguments.output.open_device();
  if (!device) return tl::unexpected(device.error());
  MatchingReport report;
  const auto done = run_matching_bench(*device, sets, arguments.options, signals.token(), report);
  return arguments.output.keep(report, done, context);
}

Action add_matching(CLI::App& group) {
  auto a = std::make_shared<MatchingArguments>();
  CLI::App* command =
      group.add_subcommand("matching", "Pair matching against OpenCV's SIFT on images");
  command
      ->add_option("SOURCE", a->sources,
                   "Folders or files of images, or synthetic[:key=value,...]; each is a set")
      ->required();
  a->reading.add_reading_options_to(*command);
  a->output.add_to(*command);
  command->add_option("--pairs", a->options.pairs, "Pairs of each set at most")
      ->check(CLI::Range(3, 100000))
      ->capture_default_str();
  command
      ->add_option("--runs", a->options.runs,
                   "Runs of each piece of work, of which the median time counts")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command->footer(R"(
Matched are images that follow each other and next-but-one images: of stills the first ones, of a
video runs of three spread over its length. Takes minutes. Ctrl-C ends it; what was measured until
then is printed and written.

Examples:
  corvid bench matching photographs/ --json matching.json
  corvid bench matching MH_05/ kitti07/ --pairs 60
  corvid bench matching video.mp4 --calibration cam.yaml --step 5
)");
  return [a](Context& context) { return run_matching(*a, context); };
}

}  // namespace

Action add_bench_command(CLI::App& app) {
  CLI::App* group =
      app.add_subcommand("bench", "Measure the engine's parts: speed, matches, accuracy");
  group->require_subcommand(1);
  group->footer(R"(
Examples:
  corvid bench ncc --quick
  corvid bench matching photographs/
  corvid bench tracking euroc/MH_05
  corvid bench mapping templeRing
)");
  std::vector<std::pair<const CLI::App*, Action>> benches;
  for (auto* add : {add_ncc, add_matching, add_bench_tracking, add_bench_mapping}) {
    Action action = add(*group);
    benches.emplace_back(group->get_subcommands([](const CLI::App*) { return true; }).back(),
                         std::move(action));
  }
  return [benches](Context& context) -> Expected<ExitCode> {
    for (const auto& [command, action] : benches) {
      if (command->parsed()) return action(context);
    }
    return ExitCode::usage;
  };
}

}  // namespace corvid
