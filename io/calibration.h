#pragma once

#include <optional>
#include <string>
#include <vector>

#include "corvid/camera.h"
#include "corvid/error.h"
#include "corvid/pose.h"

namespace corvid {

/// What a calibration file says.
struct Calibration {
  Camera camera;  ///< width_px and height_px are 0 where the file does not say them
  std::string
      format;  ///< "Kalibr camchain", "OpenCV", "ROS camera_info", "COLMAP cameras.txt", ...
  std::vector<std::string> notes;
  std::optional<Pose> T_body_camera;  ///< camera in the body or IMU frame, where the file says it
};

/// Reads a camera from a file whose format is recognised by its content: Kalibr camchain (cam0),
/// EuRoC sensor.yaml, OpenCV YAML or XML, ROS camera_info, COLMAP cameras.txt (the first camera),
/// TUM monoVO camera.txt, or a 3x3 K.txt with D.txt beside it.
/// Errors: not_found, io, corrupt (path:line), and for a key that is missing or misspelt corrupt
/// with the nearest key that the file has.
[[nodiscard]] Expected<Calibration> read_calibration(const std::string& path);

/// Makes the calibration fit images of this size: takes the size over where the file says none;
/// scales it (with a note) where the sizes differ by one factor; otherwise an error.
[[nodiscard]] Expected<Calibration> fit_calibration(Calibration calibration, int width_px,
                                                    int height_px, const std::string& where);

/// Scales a camera to another image size, pixel centres kept at whole numbers:
/// c' = (c + 0.5) s - 0.5.
[[nodiscard]] Camera scaled(const Camera& camera, int width_px, int height_px);

enum class CalibrationFormat { opencv, kalibr };
/// Writes atomically (temporary name, then rename). Re-reading gives the same camera; OpenCV's
/// format cannot name the fov model (error unsupported).
[[nodiscard]] Expected<void> write_calibration(const std::string& path, const Camera& camera,
                                               CalibrationFormat format);

}  // namespace corvid
