#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "corvid/error.h"

namespace corvid {

/// What keeps PoCL, the CPU's OpenCL, from working on this machine and can be mended.
struct OpenclTrouble {
  std::string what, remedy;
};

/// Where PoCL looks for the processors: it ends the process where this is missing.
inline constexpr char kProcessorsFolder[] = "/sys/devices/system/cpu";

/// Must be asked before OpenCL is first used. Nothing if all is well.
[[nodiscard]] std::optional<OpenclTrouble> missing_processors(
    const std::filesystem::path& processors = kProcessorsFolder);
/// The cache that kernels are kept in; nothing if it can be written.
[[nodiscard]] std::optional<OpenclTrouble> unusable_cache();

/// The error of opening a device, with what the above know about its cause.
[[nodiscard]] Error explained(Error error);

}  // namespace corvid
