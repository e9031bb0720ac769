#include "apps/program.h"

#include <fmt/format.h>
#include <spdlog/logger.h>
#include <spdlog/sinks/null_sink.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <clocale>
#include <exception>
#include <iostream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "apps/command_list.h"
#include "apps/talk.h"
#include "core/log.h"
#include "io/nearest_name.h"

namespace corvid {
namespace {

constexpr const char* kFooter = R"(
Examples:
  corvid demo                                   fly the synthetic flight, write a report
  corvid info ~/data/MH_05                      what is it, and can it be read?
  corvid replay ~/data/MH_05 --out run          trajectory, map, mesh and report into run/
  corvid replay synthetic:seed=3 --out run --json | jq .state
  corvid export run --format ply                the mesh for MeshLab or CloudCompare
  corvid eval run/trajectory.txt ~/data/MH_05   error against the truth
  corvid match a.jpg b.jpg                      what do two images have in common?
  corvid bench ncc --quick                      how fast is correlation here?

Environment:
  CORVID_DEVICE      OpenCL device, as --device takes it
  CORVID_KERNEL_DIR  reads the OpenCL kernels from this folder (for kernel development)
  XDG_CACHE_HOME     where compiled kernels are kept (default ~/.cache)
  POCL_CACHE_DIR     where PoCL, the CPU's OpenCL, keeps its own
  CORVID_TUNING      off: nothing is measured or kept, the built-in ways of computing are taken
  OCL_ICD_VENDORS    which OpenCL drivers are seen

Exit codes:
  0 done   1 unexpected failure, or the source or device failed during the run: what there was
  is saved   2 wrong arguments   3 not found
  4 corrupt or unsupported input   5 no usable OpenCL device
  6 it went through without a result: not one pose, no geometry that two images have in common,
  no surface by graph cut, or stills without depth or surface
  130 interrupted, what there was is saved
)";

// The talk of one run; the library falls silent again at its end, so that nothing refers to the
// streams of a caller that is gone.
class TalkGuard {
 public:
  TalkGuard(std::ostream& err, spdlog::level::level_enum level) {
    auto logger = std::make_shared<spdlog::logger>(
        "corvid", std::make_shared<Talk>(err, &err == &std::cerr && talks_to_journal()));
    logger->set_level(level);
    set_logger(std::move(logger));
  }
  ~TalkGuard() {
    set_logger(std::make_shared<spdlog::logger>("corvid",
                                                std::make_shared<spdlog::sinks::null_sink_mt>()));
  }
  TalkGuard(const TalkGuard&) = delete;
  TalkGuard& operator=(const TalkGuard&) = delete;
};

// An argument as a shell would take it.
std::string quoted(const std::string& argument) {
  constexpr const char* kPlain =
      "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-+=./:,@%~";
  if (!argument.empty() && argument.find_first_not_of(kPlain) == std::string::npos) return argument;
  std::string text = "'";
  for (const char c : argument) text += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return text + "'";
}

// The command that the arguments name: the last of `bench ncc`. Null if they name none.
const CLI::App* chosen(const CLI::App& app) {
  const auto parsed = app.get_subcommands();
  if (parsed.empty()) return nullptr;
  const CLI::App* deeper = chosen(*parsed.front());
  return deeper == nullptr ? parsed.front() : deeper;
}

// " bench ncc", for help.
std::string name_of(const CLI::App* command) {
  if (command == nullptr || command->get_parent() == nullptr) return {};
  return name_of(command->get_parent()) + " " + command->get_name();
}

std::vector<const CLI::App*> commands_of(const CLI::App& app) {
  return app.get_subcommands([](const CLI::App*) { return true; });
}

// What an argument that nobody expected probably meant.
std::string unexpected_argument(const CLI::App& app, const std::string& argument) {
  std::vector<std::string> known;
  const CLI::App* command = chosen(app);
  const bool option = argument.starts_with("-");
  const std::string name = argument.substr(0, argument.find('='));
  if (option) {
    for (const CLI::App* owner : {&app, command}) {
      if (owner == nullptr) continue;
      for (const CLI::Option* o : owner->get_options()) {
        for (const std::string& l : o->get_lnames()) known.push_back("--" + l);
        for (const std::string& s : o->get_snames()) known.push_back("-" + s);
      }
    }
  } else {
    for (const CLI::App* sub : commands_of(command == nullptr ? app : *command)) {
      known.push_back(sub->get_name());
    }
  }
  const char* kind = option ? "option" : known.empty() ? "argument" : "command";
  std::string hint = nearest_hint(name, known);
  if (hint.empty()) hint = fmt::format("`corvid{} --help` lists them", name_of(command));
  return fmt::format("unknown {} {} ({})", kind, argument, hint);
}

ExitCode usage(const CLI::App& app, const CLI::ParseError& error, Context& context) {
  const auto extras = app.remaining(true);
  if (!extras.empty()) {
    context.err << "error: " << unexpected_argument(app, extras.front()) << "\n";
  } else {
    context.err << fmt::format("error: {} (`corvid{} --help` shows how it is used)\n", error.what(),
                               name_of(chosen(app)));
  }
  return ExitCode::usage;
}

// Whether all results went out; says so if not.
bool written(Context& context) {
  context.out.flush();
  if (context.out) return true;
  context.err << "error: the results cannot be written to the standard output\n";
  return false;
}

ExitCode run(int argc, const char* const* argv, Context& context) {
  CLI::App app{"Corvid: camera images in; trajectory, map and mesh out.", "corvid"};
  app.set_version_flag("--version", "corvid " CORVID_VERSION);
  app.footer(kFooter);
  app.require_subcommand(1);
  app.fallthrough();
  int verbose = 0;
  app.add_flag("-v,--verbose", verbose, "More talk; -vv for everything");
  app.add_flag("-q,--quiet", context.quiet, "Warnings and errors only");

  std::vector<std::pair<const CLI::App*, Action>> commands;
  for (auto* add : {add_demo_command, add_replay_command, add_info_command, add_export_command,
                    add_eval_command, add_record_command, add_doctor_command, add_options_command,
                    add_match_command, add_mvs_command, add_bench_command, add_live_command,
                    add_cameras_command}) {
    Action action = add(app);
    commands.emplace_back(commands_of(app).back(), std::move(action));
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& help) {
    app.exit(help, context.out, context.err);
    return written(context) ? ExitCode::ok : ExitCode::failure;
  } catch (const CLI::ParseError& error) {
    return usage(app, error, context);
  }

  using Level = spdlog::level::level_enum;
  const TalkGuard talk(context.err, context.quiet  ? Level::warn
                                    : verbose == 0 ? Level::info
                                    : verbose == 1 ? Level::debug
                                                   : Level::trace);
  for (const auto& [command, action] : commands) {
    if (!command->parsed()) continue;
    const auto result = action(context);
    const bool good = written(context);
    if (!result) {
      log().error("{}", result.error().to_string());
      return exit_code(result.error().code);
    }
    return good ? *result : ExitCode::failure;
  }
  return ExitCode::usage;
}

}  // namespace

ExitCode exit_code(ErrorCode code) {
  switch (code) {
    case ErrorCode::invalid_argument:
      return ExitCode::usage;
    case ErrorCode::not_found:
      return ExitCode::not_found;
    case ErrorCode::corrupt:
    case ErrorCode::unsupported:
      return ExitCode::bad_input;
    case ErrorCode::device:
      return ExitCode::device;
    case ErrorCode::interrupted:
      return ExitCode::interrupted;
    case ErrorCode::io:
      return ExitCode::failure;
  }
  return ExitCode::failure;
}

int run_program(int argc, const char* const* argv, Context context) {
  for (int i = 0; i < argc; ++i) context.command_line += (i == 0 ? "" : " ") + quoted(argv[i]);
  try {
    return static_cast<int>(run(argc, argv, context));
  } catch (const std::exception& error) {
    context.err << fmt::format("error: this is a bug in corvid {}, please report it: {}\n",
                               CORVID_VERSION, error.what());
  } catch (...) {
    context.err << "error: this is a bug in corvid " CORVID_VERSION ", please report it\n";
  }
  return static_cast<int>(ExitCode::failure);
}

int run_program(int argc, const char* const* argv) {
  const bool terminal = isatty(STDERR_FILENO) == 1;
  return run_program(argc, argv, Context{std::cout, std::cerr, terminal, false});
}

}  // namespace corvid
