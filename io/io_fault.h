#pragma once

#include <filesystem>

#include "corvid/error.h"

namespace corvid {

/// What the system says of a path (an errno), with what mends it where that is known. Code
/// not_found for ENOENT, else io.
[[nodiscard]] tl::unexpected<Error> io_fault(const char* what, const std::filesystem::path& path,
                                             int code);

}  // namespace corvid
