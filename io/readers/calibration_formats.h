#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "corvid/camera.h"
#include "corvid/error.h"
#include "io/calibration.h"

namespace corvid {

/// The formats behind read_calibration(); `path` is for messages only.
[[nodiscard]] Expected<Calibration> parse_yaml_calibration(const std::string& text,
                                                           const std::string& path);
[[nodiscard]] Expected<Calibration> parse_opencv_xml(const std::string& text,
                                                     const std::string& path);
/// TUM monoVO: model and intrinsics, image size, ...
[[nodiscard]] Expected<Calibration> parse_mono_vo_camera(std::string_view text,
                                                         const std::string& path);
/// Nine numbers, K row by row; `distortion` is the text of D.txt or empty.
[[nodiscard]] Expected<Calibration> parse_matrix_camera(std::string_view text,
                                                        std::string_view distortion,
                                                        const std::string& path);

struct ColmapCamera {
  int id = 0;
  Camera camera;
};
[[nodiscard]] Expected<std::vector<ColmapCamera>> parse_colmap_cameras(std::string_view text,
                                                                       const std::string& path);

/// Puts radial-tangential coefficients in OpenCV's order (0, 2, 4, 5, 8, 12 or 14 of them) into the
/// camera: pinhole if all are zero. Errors: the rational and thin-prism terms that are not zero.
[[nodiscard]] Expected<void> set_radtan(Camera& camera, std::span<const double> coefficients,
                                        const std::string& where);
/// Checks a finished camera; a size of 0 x 0 means "not said".
[[nodiscard]] Expected<void> check_camera(const Camera& camera, const std::string& where);

}  // namespace corvid
