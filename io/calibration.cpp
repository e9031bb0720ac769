#include "io/calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <string_view>
#include <utility>

#include "io/atomic_file.h"
#include "io/readers/calibration_formats.h"
#include "io/readers/text.h"

namespace corvid {
namespace {

constexpr std::string_view kKnownFormats =
    "known are Kalibr camchain, EuRoC sensor.yaml, OpenCV YAML and XML, ROS camera_info, COLMAP "
    "cameras.txt, TUM monoVO camera.txt, and a 3x3 matrix in K.txt";

// COLMAP's rows start with the camera's number and the model's name in capitals.
bool looks_like_colmap(const std::vector<TextLine>& lines) {
  const std::vector<std::string_view> parts = fields(lines.front().text);
  return parts.size() >= 5 && to_integer(parts[0]) &&
         std::isupper(static_cast<unsigned char>(parts[1].front())) != 0;
}

bool looks_like_matrix(const std::vector<TextLine>& lines) {
  if (lines.size() != 1 && lines.size() != 3) return false;
  for (const TextLine& line : lines) {
    if (fields(line.text).size() != 9 / lines.size()) return false;
  }
  return true;
}

Expected<Calibration> read_text(const std::string& text, const std::string& path) {
  const std::vector<TextLine> lines = data_lines(text);
  if (lines.empty()) return fail(ErrorCode::corrupt, "the calibration file is empty", path);
  if (looks_like_colmap(lines)) {
    const auto cameras = parse_colmap_cameras(text, path);
    if (!cameras) return tl::unexpected(cameras.error());
    Calibration result;
    result.camera = cameras->front().camera;
    result.format = "COLMAP cameras.txt";
    if (cameras->size() > 1) {
      result.notes.push_back(
          fmt::format("{} has {} cameras; the first is used", path, cameras->size()));
    }
    return result;
  }
  if (looks_like_matrix(lines)) {
    const std::filesystem::path beside = std::filesystem::path(path).parent_path() / "D.txt";
    std::string distortion;
    std::error_code ignored;
    if (std::filesystem::is_regular_file(beside, ignored)) {
      Expected<std::string> d = read_file_bytes(beside);
      if (!d) return tl::unexpected(d.error());
      distortion = std::move(*d);
    }
    return parse_matrix_camera(text, distortion, path);
  }
  return parse_mono_vo_camera(text, path);
}

}  // namespace

Expected<void> check_camera(const Camera& camera, const std::string& where) {
  Camera checked = camera;
  if (checked.width_px == 0 && checked.height_px == 0) checked.width_px = checked.height_px = 1;
  const std::string problems = checked.validate();
  if (!problems.empty()) return fail(ErrorCode::corrupt, problems, where);
  return {};
}

Expected<void> set_radtan(Camera& camera, std::span<const double> coefficients,
                          const std::string& where) {
  const std::size_t n = coefficients.size();
  if (n != 0 && n != 1 && n != 2 && n != 4 && n != 5 && n != 8 && n != 12 && n != 14) {
    return fail(ErrorCode::corrupt, fmt::format("{} distortion coefficients", n), where,
                "the radial-tangential model has 4 or 5: k1 k2 p1 p2 k3");
  }
  if (n > 5 &&
      std::any_of(coefficients.begin() + 5, coefficients.end(), [](double c) { return c != 0; })) {
    return fail(ErrorCode::unsupported,
                "the rational or thin-prism distortion terms (the sixth and later) are not zero",
                where, "calibrate again with five coefficients: k1 k2 p1 p2 k3");
  }
  camera.distortion = {};
  std::copy_n(coefficients.begin(), std::min<std::size_t>(n, 5), camera.distortion.begin());
  const bool straight = std::all_of(camera.distortion.begin(), camera.distortion.end(),
                                    [](double c) { return c == 0; });
  camera.model = straight ? CameraModel::pinhole : CameraModel::radtan;
  return {};
}

Expected<Calibration> read_calibration(const std::string& path) {
  const Expected<std::string> text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  if (text->size() > std::size_t{16} << 20 || text->find('\0') != std::string::npos) {
    return fail(ErrorCode::unsupported, "this is not a calibration file", path,
                std::string(kKnownFormats));
  }
  const std::string ending = lower_case(std::filesystem::path(path).extension().string());
  const std::string_view start = trim(std::string_view(*text).substr(0, 200));
  Expected<Calibration> result =
      ending == ".xml" || start.starts_with("<?xml") ? parse_opencv_xml(*text, path)
      : ending == ".yaml" || ending == ".yml" || start.starts_with("%YAML")
          ? parse_yaml_calibration(*text, path)
          : read_text(*text, path);
  if (!result) return result;
  if (const auto checked = check_camera(result->camera, path); !checked) {
    return tl::unexpected(checked.error());
  }
  return result;
}

Camera scaled(const Camera& camera, int width_px, int height_px) {
  const double sx = static_cast<double>(width_px) / camera.width_px;
  const double sy = static_cast<double>(height_px) / camera.height_px;
  Camera result = camera;
  result.width_px = width_px;
  result.height_px = height_px;
  result.fx_px *= sx;
  result.fy_px *= sy;
  result.cx_px = (camera.cx_px + 0.5) * sx - 0.5;
  result.cy_px = (camera.cy_px + 0.5) * sy - 0.5;
  return result;
}

Expected<Calibration> fit_calibration(Calibration calibration, int width_px, int height_px,
                                      const std::string& where) {
  Camera& camera = calibration.camera;
  if (camera.width_px == 0 && camera.height_px == 0) {
    camera.width_px = width_px;
    camera.height_px = height_px;
    // Nothing says whether the images were resized since; a centre this far off says it.
    if (camera.cx_px < 0.2 * width_px || camera.cx_px > 0.8 * width_px ||
        camera.cy_px < 0.2 * height_px || camera.cy_px > 0.8 * height_px) {
      calibration.notes.push_back(fmt::format(
          "the calibration's principal point ({:.1f}, {:.1f}) is far from the middle of the {} x "
          "{} images: check that it was made for this image size",
          camera.cx_px, camera.cy_px, width_px, height_px));
    }
    return calibration;
  }
  if (camera.width_px == width_px && camera.height_px == height_px) return calibration;
  // One factor up to the rounding of the smaller size to whole pixels.
  const double sx = static_cast<double>(width_px) / camera.width_px;
  const double sy = static_cast<double>(height_px) / camera.height_px;
  const double rounding = sx < 1 ? 1.0 / std::min(width_px, height_px)
                                 : 1.0 / std::min(camera.width_px, camera.height_px);
  if (std::abs(sx / sy - 1) > std::min(rounding, 0.02)) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("the calibration is for {} x {} pixels but the images have {} x {}",
                            camera.width_px, camera.height_px, width_px, height_px),
                where, "give the calibration of these images");
  }
  calibration.notes.push_back(
      fmt::format("the calibration for {} x {} pixels was scaled to the images' {} x {}",
                  camera.width_px, camera.height_px, width_px, height_px));
  camera = scaled(camera, width_px, height_px);
  return calibration;
}

}  // namespace corvid
