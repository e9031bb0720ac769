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

/// Where the OpenCL loader looks for its vendors' files: a folder, or a single file.
[[nodiscard]] std::filesystem::path vendor_files();

/// Must be asked before OpenCL is first used. Nothing if all is well or `vendors` do not name PoCL.
/// Holds for a run on a GPU too: to find it every vendor is asked, and PoCL ends the process then.
[[nodiscard]] std::optional<OpenclTrouble> missing_processors(
    const std::filesystem::path& processors = kProcessorsFolder,
    const std::filesystem::path& vendors = vendor_files());
/// The cache that kernels are kept in; nothing if it can be written.
[[nodiscard]] std::optional<OpenclTrouble> unusable_cache();

/// The error of opening a device, with what the above know about its cause if there is no device
/// at all.
[[nodiscard]] Error explained(Error error);

/// What `open()`, an Expected of something that opens an OpenCL device, gives, with the checks
/// before it and its error explained.
template <typename Open>
[[nodiscard]] auto open_explained(Open open) -> decltype(open()) {
  if (const auto trouble = missing_processors()) {
    return fail(ErrorCode::device, trouble->what, "OpenCL", trouble->remedy);
  }
  auto opened = open();
  if (!opened) return tl::unexpected(explained(opened.error()));
  return opened;
}

}  // namespace corvid
