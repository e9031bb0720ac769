#include "apps/engine_options.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>

#include "io/options_file.h"

namespace corvid {

void EngineArguments::add_to(CLI::App& command) {
  command
      .add_option("--device", device,
                  "OpenCL device: auto, cpu, gpu, or a number from `corvid doctor`")
      ->envname("CORVID_DEVICE");
  command.add_option("--options", file, "Options file (`corvid options` prints one)");
  command
      .add_option("--set", settings,
                  "KEY=VALUE, one option of the engine; wins over the file; may be repeated")
      ->allow_extra_args(false);
}

Expected<Options> EngineArguments::read() const {
  Options options;
  if (!file.empty()) {
    auto from_file = read_options_file(file);
    if (!from_file) return from_file;
    options = *from_file;
  }
  for (const std::string& setting : settings) {
    const std::size_t equals = setting.find('=');
    if (equals == std::string::npos) {
      return fail(ErrorCode::invalid_argument, fmt::format("{} is not KEY=VALUE", setting), "--set",
                  "`corvid options` prints every key");
    }
    auto set = set_option(options, setting.substr(0, equals), setting.substr(equals + 1), "--set");
    if (!set) return tl::unexpected(set.error());
  }
  if (device) options.device = *device;
  return options;
}

}  // namespace corvid
