#pragma once

#include <memory>
#include <string>

#include "corvid/error.h"
#include "corvid/ports.h"
#include "io/source.h"

namespace CLI {
class App;
}

namespace corvid {

/// A source as the command line names it: a folder, a file, or `synthetic[:key=value,...]`.
struct SourceArguments {
  std::string spec;
  SourceOptions options;

  /// Adds SOURCE, --calibration, --frame-rate, --first, --count, --step and --grey to a command.
  void add_to(CLI::App& command);
  /// Adds only those of them that say which images are read and how: all but SOURCE and --grey.
  void add_reading_options_to(CLI::App& command);
  [[nodiscard]] Expected<std::unique_ptr<FrameSource>> open() const;
};

/// The keys that `synthetic:` takes, one line each, for help.
[[nodiscard]] std::string synthetic_help();

/// "EuRoC/ASL ../MH_05: 300 frames, 752x480, 20 Hz, radtan, intrinsics from calibration".
[[nodiscard]] std::string describe(const SourceInfo& info);
[[nodiscard]] std::string_view to_string(IntrinsicsOrigin origin);
/// The same for programs: calibration, exif, nominal, guess.
[[nodiscard]] std::string_view name_of(IntrinsicsOrigin origin);
/// Warns of every frame that could not be read.
void log_skipped(const SourceCounts& counts);

}  // namespace corvid
