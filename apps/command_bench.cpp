#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "apps/command_list.h"
#include "apps/opencl_trouble.h"
#include "apps/signal_guard.h"
#include "bench/ncc_bench.h"
#include "core/log.h"
#include "io/atomic_file.h"

namespace corvid {
namespace {

struct NccArguments {
  std::string device = "auto";
  std::optional<std::string> json;
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
  if (arguments.json) {  // found out before minutes of measuring
    if (auto writable = check_file_writable(*arguments.json); !writable)
      return tl::unexpected(writable.error());
  }
  const SignalGuard signals;
  auto device = open_explained([&] { return Device::open(arguments.device); });
  if (!device) return tl::unexpected(device.error());
  NccReport report;
  const auto done = run_ncc_bench(*device, options, signals.token(), report);
  // What was measured is kept, whatever happened after it.
  print(report, context.out);
  if (arguments.json) {
    if (auto written = write_file_atomically(*arguments.json, json_rows(report)); !written)
      return tl::unexpected(written.error());
  }
  if (!done) return tl::unexpected(done.error());
  const std::vector<std::string> wrong = disagreements(report);
  for (const std::string& sentence : wrong) log().error("{}", sentence);
  if (!wrong.empty()) return ExitCode::failure;
  return report.interrupted ? ExitCode::interrupted : ExitCode::ok;
}

Action add_ncc(CLI::App& group) {
  auto a = std::make_shared<NccArguments>();
  CLI::App* command = group.add_subcommand(
      "ncc", "Normalized cross-correlation against OpenCV and against the machine's peak");
  const NccBenchOptions defaults;
  std::vector<std::string> tables;
  for (const NccTable table : kNccTables) tables.emplace_back(to_string(table));
  command->add_option("--json", a->json, "File for the rows, as a JSON array");
  command->add_option("--device", a->device, "auto, cpu, gpu, or a number from `corvid doctor`")
      ->envname("CORVID_DEVICE")
      ->capture_default_str();
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

}  // namespace

Action add_bench_command(CLI::App& app) {
  CLI::App* group = app.add_subcommand("bench", "Measure the speed of the engine's parts");
  group->require_subcommand(1);
  group->footer(R"(
Examples:
  corvid bench ncc --quick
  corvid bench tracking euroc/MH_05
)");
  std::vector<std::pair<const CLI::App*, Action>> benches;
  for (auto* add : {add_ncc, add_bench_tracking}) {
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
