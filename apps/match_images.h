#pragma once

#include <stop_token>
#include <string>
#include <vector>

#include "apps/program_source.h"
#include "corvid/camera.h"
#include "corvid/error.h"
#include "corvid/image.h"
#include "corvid/ports.h"

namespace corvid {

/// An image that shall be matched, with its camera.
struct MatchImage {
  std::string name;  ///< the file's, or "frame 7"
  GreyImage grey;
  Camera camera;
  IntrinsicsOrigin intrinsics = IntrinsicsOrigin::calibration;
  std::vector<std::string> notes;  ///< what was assumed, one sentence each
};

/// An image smaller than this on either side is refused: it cannot hold enough corners.
inline constexpr int kMinMatchSide_px = 32;

/// Reads an image file. Its camera is the calibration's where one is given (scaled to the image's
/// size), else from EXIF, else guessed.
/// Errors: as read_image() and read_calibration(); unsupported for an image that is too small.
[[nodiscard]] Expected<MatchImage> read_match_image(const std::string& path,
                                                    const std::string& calibration_path);

/// Frames of a source by their numbers, counted from 0 as --first counts them.
/// Errors: those of the source; invalid_argument for a number that it does not have; unsupported
/// for images that are too small; interrupted.
[[nodiscard]] Expected<std::vector<MatchImage>> read_match_frames(const SourceArguments& source,
                                                                  const std::vector<int>& frames,
                                                                  const std::stop_token& stop);

}  // namespace corvid
