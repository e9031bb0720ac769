#pragma once

#include <memory>
#include <optional>
#include <string>

#include "corvid/error.h"
#include "corvid/ports.h"

namespace corvid {

/// How a source is opened.
struct SourceOptions {
  /// Camera calibration file, instead of what lies beside the images (see read_calibration()).
  std::string calibration_path;
  /// Frame rate [Hz], instead of the source's own times: image i of the whole source, counted from
  /// 0, comes at i / rate_hz.
  std::optional<double> rate_hz;
  int first = 0;       ///< images left out at the start
  int count = -1;      ///< images taken after that; negative: all
  int step = 1;        ///< every step-th image is taken
  bool colour = true;  ///< false: Frame::colour stays empty even where the images have colour
};

/// Opens a folder or file of images; the kind is recognised from what lies there (docs/formats.md).
/// Errors: not_found (no such path), unsupported (nothing known lies there: the message lists what
/// was looked for), corrupt (a file of the format is wrong: path:line).
[[nodiscard]] Expected<std::unique_ptr<FrameSource>> open_source(const std::string& path,
                                                                 const SourceOptions& options = {});

}  // namespace corvid
