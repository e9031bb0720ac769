#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>
#include <ostream>

#include "apps/command_list.h"
#include "apps/program_source.h"
#include "apps/progress.h"
#include "apps/signal_guard.h"
#include "core/log.h"

namespace corvid {
namespace {

struct Arguments {
  SourceArguments source;
  bool check = false, json = false;
};

void print(std::ostream& out, const SourceInfo& info, const Trajectory& truth, bool surface) {
  const auto row = [&out](std::string_view name, const std::string& value) {
    out << fmt::format("{:<12} {}\n", name, value);
  };
  row("kind", info.kind);
  if (!info.path.empty()) row("path", info.path);
  row("frames", info.frames ? std::to_string(*info.frames) : "unknown");
  row("rate", info.stills        ? "stills"
              : info.rate_hz > 0 ? fmt::format("{:.4g} Hz", info.rate_hz)
                                 : "unknown");
  if (info.camera) {
    const Camera& c = *info.camera;
    row("size",
        fmt::format("{}x{} px, {}", c.width_px, c.height_px, info.colour ? "colour" : "grey"));
    row("camera", fmt::format("{}, fx {:.2f} fy {:.2f} cx {:.2f} cy {:.2f} px", to_string(c.model),
                              c.fx_px, c.fy_px, c.cx_px, c.cy_px));
    if (c.model != CameraModel::pinhole) {
      row("distortion", fmt::format("{:.6g}", fmt::join(c.distortion, " ")));
    }
    row("intrinsics", fmt::format("from {}", to_string(info.intrinsics)));
  }
  row("depth", info.has_depth ? "beside the frames" : "none");
  row("truth", truth.empty() ? "none" : fmt::format("{} poses", truth.size()));
  if (surface) row("surface", "known exactly");
  for (const auto& note : info.notes) row("note", note);
}

Expected<ExitCode> run(const Arguments& arguments, Context& context) {
  const SignalGuard signals;
  auto source = arguments.source.open();
  if (!source) return tl::unexpected(source.error());
  const SourceInfo info = (*source)->info();
  const Trajectory truth = (*source)->truth();
  const bool surface = (*source)->true_surface().has_value();
  nlohmann::ordered_json json = to_json(info);
  json["truth_poses"] = truth.size();
  json["true_surface"] = surface;
  if (!arguments.json) print(context.out, info, truth, surface);

  ExitCode code = ExitCode::ok;
  if (arguments.check) {
    while (true) {
      auto frame = (*source)->next(signals.token());
      if (!frame) return tl::unexpected(frame.error());
      if (*frame == nullptr) break;
      if (signals.token().stop_requested()) {
        code = ExitCode::interrupted;
        break;
      }
    }
    const SourceCounts counts = (*source)->counts();
    json["check"] = to_json(counts);
    if (!arguments.json) {
      context.out << fmt::format("{:<12} {} frames can be read, {} cannot\n", "check",
                                 counts.delivered, counts.skipped);
      for (const auto& message : counts.messages) {
        context.out << fmt::format("{:<12} {}\n", "skipped", message);
      }
    }
    if (code == ExitCode::ok && counts.delivered == 0) {
      log().error("{}: not one frame can be read", arguments.source.spec);
      code = ExitCode::bad_input;
    }
  }
  if (arguments.json) write_json_line(context.out, json);
  return code;
}

}  // namespace

Action add_info_command(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand("info", "Say what a source is");
  arguments->source.add_to(*command);
  command->add_flag("--check", arguments->check, "Read every frame and list those that cannot be");
  command->add_flag("--json", arguments->json, "One JSON object on the standard output");
  command->footer("\nKeys of synthetic:key=value,...\n" + synthetic_help() + R"(
Examples:
  corvid info ~/data/MH_05
  corvid info photos/ --check
  corvid info synthetic:seed=3,duration=10,path=orbit --json
)");
  return [arguments](Context& context) { return run(*arguments, context); };
}

}  // namespace corvid
