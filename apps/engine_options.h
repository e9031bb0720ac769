#pragma once

#include <optional>
#include <string>
#include <vector>

#include "corvid/error.h"
#include "corvid/options.h"

namespace CLI {
class App;
}

namespace corvid {

/// The engine's options as the command line gives them.
struct EngineArguments {
  std::string file;
  std::vector<std::string> settings;
  std::optional<std::string> device;

  /// Adds --device, --options and --set to a command.
  void add_to(CLI::App& command);
  /// The file's values, then those of --set and --device; the command's own switches come after
  /// them, then check_options().
  [[nodiscard]] Expected<Options> read() const;
};

}  // namespace corvid
