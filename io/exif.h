#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "corvid/position.h"

namespace corvid {

/// What a photograph says of itself.
struct Exif {
  std::string make, model;
  std::optional<double> focal_mm;
  std::optional<double> focal_35mm;       ///< 35-mm equivalent [mm]
  std::optional<double> plane_px_per_mm;  ///< focal plane resolution of the original image
  int original_width_px = 0;              ///< PixelXDimension, 0 if absent
  std::optional<std::int64_t> time_ns;    ///< DateTimeOriginal with its fraction, taken as UTC
  int orientation = 1;                    ///< 1 to 8; anything but 1 asks viewers to turn it
  std::optional<GeodeticPosition> gps;    ///< with its altitude; nothing if any part is missing
  std::optional<double> gps_sigma_m;      ///< GPSHPositioningError: horizontal
  /// True if a camera says that it took this picture (make, model or focal length).
  [[nodiscard]] bool from_camera() const {
    return !make.empty() || !model.empty() || focal_mm || focal_35mm;
  }
};

/// Reads the EXIF part of a JPEG file; nothing where there is none.
[[nodiscard]] std::optional<Exif> read_exif(const std::string& path);

struct ExifFocal {
  double focal_px = 0;
  std::string how;  ///< "35-mm equivalent", "sensor width of the Canon PowerShot SX260 HS", ...
};
/// Focal length in pixels of an image of this size, best source first: 35-mm equivalent (ratio of
/// the diagonals, CIPA DCG-001), sensor width of a known camera, focal plane resolution.
[[nodiscard]] std::optional<ExifFocal> exif_focal(const Exif& exif, int width_px, int height_px);

}  // namespace corvid
