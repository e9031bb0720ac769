#pragma once

#include <cstddef>
#include <span>
#include <string>

#include "mapping/still_depth.h"
#include "mapping/surface_cut.h"

namespace corvid {

/// What `corvid mvs` did, for its page and its JSON file.
struct MvsRun {
  std::string source, device, version;
  std::span<const StillView> views;
  std::span<const StillDepth> depths;
  std::size_t points = 0;               ///< that at least 3 views agree on
  double seconds = 0;                   ///< of depth maps and points
  const SurfaceCut* surface = nullptr;  ///< null if there is none; else with triangles
  std::string no_surface{};             ///< why not; empty if none was asked for
};

/// One self-contained page: a table of all views, pictures of image, depth and confidence of some.
[[nodiscard]] std::string mvs_html(const MvsRun& run);
/// The same numbers (docs/formats.md).
[[nodiscard]] std::string mvs_json(const MvsRun& run);

}  // namespace corvid
