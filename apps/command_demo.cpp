#include <CLI/CLI.hpp>
#include <memory>
#include <optional>
#include <string>

#include "apps/command_flight.h"
#include "apps/command_list.h"
#include "apps/signal_guard.h"
#include "replay/synthetic_flight.h"

namespace corvid {
namespace {

struct Arguments {
  std::string out = "out/demo";
  std::optional<std::string> device;
  bool quick = false, json = false;
};

Expected<ExitCode> run(const Arguments& arguments, Context& context) {
  const SignalGuard signals;
  FlightOptions options;
  options.width_px = arguments.quick ? 480 : 640;
  options.height_px = arguments.quick ? 320 : 416;
  options.duration_s = arguments.quick ? 4 : 12;
  options.rate_hz = arguments.quick ? 15 : 20;
  auto flight = SyntheticFlight::open(options);
  if (!flight) return tl::unexpected(flight.error());
  FlightPlan plan;
  plan.source = std::move(*flight);
  if (arguments.device) plan.options.device = *arguments.device;
  plan.out = arguments.out;
  plan.json = arguments.json;
  return fly(std::move(plan), signals, context);
}

}  // namespace

Action add_demo_command(CLI::App& app) {
  auto a = std::make_shared<Arguments>();
  CLI::App* command =
      app.add_subcommand("demo", "Fly the synthetic flight and compare with its exact truth");
  command->add_option("--out", a->out, "Folder to write")->capture_default_str();
  command->add_option("--device", a->device, "OpenCL device: auto, cpu, gpu or a number")
      ->envname("CORVID_DEVICE");
  command->add_flag("--quick", a->quick, "A shorter flight of smaller images");
  command->add_flag("--json", a->json, "One line of JSON per event on the standard output");
  command->footer(R"(
Other flights: corvid replay synthetic:seed=3,duration=30,path=orbit --out DIR
(`corvid info --help` lists the keys).
)");
  return [a](Context& context) { return run(*a, context); };
}

}  // namespace corvid
