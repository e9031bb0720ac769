#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <ostream>
#include <string>

#include "apps/command_list.h"
#include "io/options_file.h"

namespace corvid {

Action add_options_command(CLI::App& app) {
  auto file = std::make_shared<std::string>();
  CLI::App* command = app.add_subcommand(
      "options", "Print every option of the engine with its default, as an options file");
  command->add_option("--options", *file, "Print the values of this file instead of the defaults");
  command->footer(R"(
Examples:
  corvid options > mine.yaml                         a file to edit
  corvid replay SOURCE --out run --options mine.yaml
  corvid replay SOURCE --out run --set frontend.max_tracks=500 --set mapping.enabled=false
)");
  return [file](Context& context) -> Expected<ExitCode> {
    Options options;
    if (!file->empty()) {
      auto read = read_options_file(*file);
      if (!read) return tl::unexpected(read.error());
      options = *read;
    }
    context.out << fmt::format("# Options of corvid {}\n", CORVID_VERSION)
                << options_to_yaml(options);
    return ExitCode::ok;
  };
}

}  // namespace corvid
