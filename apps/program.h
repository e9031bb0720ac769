#pragma once

#include <iosfwd>
#include <string>

#include "corvid/error.h"

namespace corvid {

/// What the program tells the shell (docs/conventions.md).
enum class ExitCode : int {
  ok = 0,
  failure = 1,        ///< unexpected: a bug, a full disk
  usage = 2,          ///< wrong arguments or options
  not_found = 3,      ///< no such file, folder or camera
  bad_input = 4,      ///< corrupt or unsupported
  device = 5,         ///< no OpenCL device can run the engine
  no_estimate = 6,    ///< it went through, but no pose or no geometry came out
  interrupted = 130,  ///< SIGINT or SIGTERM; the partial result is saved
};
[[nodiscard]] ExitCode exit_code(ErrorCode code);

/// Where a command writes: results to `out`, talk to `err`.
struct Context {
  std::ostream& out;
  std::ostream& err;
  bool terminal = false;       ///< err is a terminal: progress may be drawn
  bool quiet = false;          ///< -q: warnings and errors only
  std::string command_line{};  ///< as it was typed; set by run_program()
};

/// The whole program. Never throws; the result is an ExitCode.
[[nodiscard]] int run_program(int argc, const char* const* argv);
/// The same on other streams; what tests call. Not thread-safe: it replaces the library's logger.
[[nodiscard]] int run_program(int argc, const char* const* argv, Context context);

}  // namespace corvid
