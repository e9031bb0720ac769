#include <fmt/format.h>
#include <fmt/ranges.h>

#include <array>
#include <span>

#include "io/atomic_file.h"
#include "io/calibration.h"

namespace corvid {
namespace {

std::string list(std::span<const double> values) {
  std::string text = "[";
  for (std::size_t i = 0; i < values.size(); ++i) {
    // Always with a point: OpenCV reads "0" in a matrix of doubles, others do not.
    std::string number = fmt::format("{:.17g}", values[i]);
    if (number.find_first_of(".en") == std::string::npos) number += ".0";
    text += (i ? ", " : "") + number;
  }
  return text + "]";
}

std::string matrix(std::string_view name, int rows, int cols, std::span<const double> values) {
  return fmt::format("{}: !!opencv-matrix\n  rows: {}\n  cols: {}\n  dt: d\n  data: {}\n", name,
                     rows, cols, list(values));
}

std::size_t coefficient_count(CameraModel model) {
  switch (model) {
    case CameraModel::pinhole:
      return 0;
    case CameraModel::radtan:
      return 5;
    case CameraModel::equidistant:
      return 4;
    case CameraModel::fov:
      return 1;
  }
  return 0;
}

std::string opencv_text(const Camera& c) {
  const std::array<double, 9> k = {c.fx_px, 0, c.cx_px, 0, c.fy_px, c.cy_px, 0, 0, 1};
  // OpenCV's readers want the coefficients to be there: five zeros for a pinhole.
  const std::size_t count = c.model == CameraModel::equidistant ? 4 : 5;
  return fmt::format("%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\nfisheye_model: {}\n",
                     c.width_px, c.height_px, c.model == CameraModel::equidistant ? 1 : 0) +
         matrix("camera_matrix", 3, 3, k) +
         matrix("distortion_coefficients", 1, static_cast<int>(count),
                std::span(c.distortion).first(count));
}

std::string kalibr_text(const Camera& c) {
  const std::array<double, 4> k = {c.fx_px, c.fy_px, c.cx_px, c.cy_px};
  const std::size_t count =
      c.model == CameraModel::radtan ? 4 : coefficient_count(c.model);  // Kalibr has no k3
  static constexpr std::array<std::string_view, 4> kNames = {"none", "radtan", "equidistant",
                                                             "fov"};
  return fmt::format(
      "cam0:\n  camera_model: pinhole\n  intrinsics: {}\n  distortion_model: {}\n"
      "  distortion_coeffs: {}\n  resolution: [{}, {}]\n",
      list(k), kNames[static_cast<std::size_t>(c.model)],
      list(std::span(c.distortion).first(count)), c.width_px, c.height_px);
}

}  // namespace

Expected<void> write_calibration(const std::string& path, const Camera& camera,
                                 CalibrationFormat format) {
  if (format == CalibrationFormat::opencv && camera.model == CameraModel::fov) {
    return fail(ErrorCode::unsupported, "OpenCV's format cannot name the FOV model", path,
                "write a Kalibr camchain");
  }
  if (format == CalibrationFormat::kalibr && camera.model == CameraModel::radtan &&
      camera.distortion[4] != 0) {
    return fail(ErrorCode::unsupported, "Kalibr's radial-tangential model has no k3", path,
                "write OpenCV's format");
  }
  return write_file_atomically(
      path, format == CalibrationFormat::opencv ? opencv_text(camera) : kalibr_text(camera));
}

}  // namespace corvid
