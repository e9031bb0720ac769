#pragma once

#include <span>
#include <string>
#include <string_view>

#include "corvid/error.h"
#include "kernels/device.h"

namespace corvid {

/// One .cl file as it was when the library was built.
struct EmbeddedKernel {
  std::string_view name;    ///< file name without ending
  std::string_view source;  ///< OpenCL C 1.2
  std::string_view sha256;  ///< of the source, hexadecimal
};

/// All of them, sorted by name.
[[nodiscard]] std::span<const EmbeddedKernel> embedded_kernels();

/// Builds kernels/`name`.cl (or, of "a+b", a.cl followed by b.cl) for the device, or takes it from
/// the device's memory of programs, or from the binary cache in cache_folder()/programs. A cache
/// file that is corrupt or was made for something else is ignored and written again; a cache that
/// cannot be written is only logged. With CORVID_KERNEL_DIR in the environment the source is read
/// from that folder each time.
/// @param options  compiler options; "-cl-std=CL1.2" is added.
/// @return not_found if no kernel has the name; device, with the build log, if it does not build.
/// Thread-safe.
[[nodiscard]] Expected<cl::Program> build_program(Device& device, std::string_view name,
                                                  const std::string& options = {});

/// Identifies the sources that build_program() would take for a name. not_found as there.
[[nodiscard]] Expected<std::string> program_id(std::string_view name);

}  // namespace corvid
