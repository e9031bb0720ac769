#pragma once

#include <string>
#include <vector>

#include "corvid/error.h"
#include "corvid/position.h"

namespace corvid {

struct PositionsFile {
  std::vector<PositionFix> fixes;  ///< in the order of the file
  int without_fix = 0;             ///< rows whose coordinates are all empty or nan
};

/// Reads positions from comma-separated values with a header (docs/formats.md): one of `time_ns`,
/// `time_s` and `name`; `latitude_deg`, `longitude_deg`, `altitude_m`; `sigma_horizontal_m` and
/// `sigma_vertical_m` if they are known. Other columns are left alone.
/// Errors: not_found, io, corrupt (path:line).
[[nodiscard]] Expected<PositionsFile> read_positions(const std::string& path);

}  // namespace corvid
