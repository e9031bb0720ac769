#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <ostream>
#include <string>

#include "apps/command_list.h"
#include "apps/program_source.h"
#include "apps/signal_guard.h"
#include "core/log.h"
#include "replay/recorder.h"

namespace corvid {
namespace {

struct Arguments {
  SourceArguments source;
  std::string out;
};

Expected<ExitCode> run(const Arguments& arguments, Context& context) {
  const SignalGuard signals;
  auto source = arguments.source.open();
  if (!source) return tl::unexpected(source.error());
  log().info("recording {}", describe((*source)->info()));
  auto written = record(**source, arguments.out, signals.token());
  if (!written) return tl::unexpected(written.error());
  const SourceCounts counts = (*source)->counts();
  log_skipped(counts);
  context.out << fmt::format("{} frames, {} skipped: {}\n", *written, counts.skipped,
                             arguments.out);
  if (signals.token().stop_requested()) return ExitCode::interrupted;
  if (*written == 0) {
    return fail(ErrorCode::corrupt, "not one frame could be read", arguments.source.spec,
                "`corvid info --check` says why");
  }
  return ExitCode::ok;
}

}  // namespace

Action add_record_command(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  CLI::App* command =
      app.add_subcommand("record", "Write a source as an ASL (EuRoC) folder, without loss");
  arguments->source.add_to(*command);
  command->add_option("--out", arguments->out, "Folder to write; must hold no recording yet")
      ->required();
  command->footer(R"(
Examples:
  corvid record video.mp4 --calibration cam.yaml --out recording
  corvid record synthetic:seed=3,duration=10 --out town
)");
  return [arguments](Context& context) { return run(*arguments, context); };
}

}  // namespace corvid
