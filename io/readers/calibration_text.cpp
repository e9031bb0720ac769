#include <fmt/format.h>

#include <array>
#include <cmath>
#include <limits>

#include "io/nearest_name.h"
#include "io/readers/calibration_formats.h"
#include "io/readers/text.h"

namespace corvid {
namespace {

constexpr int kMaxSide_px = 1 << 20;

// COLMAP and the monoVO format put (0, 0) at the corner of the first pixel, we at its centre.
constexpr double kHalf_px = 0.5;

struct ColmapModel {
  std::string_view name;
  std::size_t parameters;
};
// COLMAP, src/base/camera_models.h (documentation "Camera Models").
constexpr std::array kColmapModels = {
    ColmapModel{"SIMPLE_PINHOLE", 3}, ColmapModel{"PINHOLE", 4},
    ColmapModel{"SIMPLE_RADIAL", 4},  ColmapModel{"RADIAL", 5},
    ColmapModel{"OPENCV", 8},         ColmapModel{"FULL_OPENCV", 12},
    ColmapModel{"OPENCV_FISHEYE", 8}, ColmapModel{"SIMPLE_RADIAL_FISHEYE", 4},
    ColmapModel{"RADIAL_FISHEYE", 5}, ColmapModel{"FOV", 5}};

Expected<Camera> colmap_camera(std::string_view model, const std::vector<double>& p,
                               const std::string& where) {
  Camera camera;
  const bool one_focal = model.starts_with("SIMPLE") || model.starts_with("RADIAL");
  std::size_t i = 0;
  camera.fx_px = p[i++];
  camera.fy_px = one_focal ? camera.fx_px : p[i++];
  camera.cx_px = p[i++] - kHalf_px;
  camera.cy_px = p[i++] - kHalf_px;
  const std::span<const double> rest(p.data() + i, p.size() - i);
  if (model == "FOV" || model.ends_with("FISHEYE")) {
    camera.model = model == "FOV" ? CameraModel::fov : CameraModel::equidistant;
    std::copy(rest.begin(), rest.end(), camera.distortion.begin());
    return camera;
  }
  if (const auto set = set_radtan(camera, rest, where); !set) return tl::unexpected(set.error());
  return camera;
}

}  // namespace

Expected<std::vector<ColmapCamera>> parse_colmap_cameras(std::string_view text,
                                                         const std::string& path) {
  std::vector<ColmapCamera> cameras;
  for (const TextLine& line : data_lines(text)) {
    const std::string where = at_line(path, line.number);
    const std::vector<std::string_view> parts = fields(line.text, " \t");
    if (parts.size() < 5) {
      return fail(ErrorCode::corrupt, "a camera row needs: id, model, width, height, parameters",
                  where);
    }
    const ColmapModel* model = nullptr;
    std::vector<std::string> names;
    for (const ColmapModel& known : kColmapModels) {
      names.emplace_back(known.name);
      if (known.name == parts[1]) model = &known;
    }
    if (!model) {
      return fail(ErrorCode::unsupported, fmt::format("unknown camera model \"{}\"", parts[1]),
                  where, nearest_hint(parts[1], names));
    }
    const auto id = to_integer(parts[0]), width = to_integer(parts[2]),
               height = to_integer(parts[3]);
    std::vector<double> parameters;
    for (std::size_t i = 4; i < parts.size(); ++i) {
      const std::optional<double> number = to_number(parts[i]);
      if (!number) {
        return fail(ErrorCode::corrupt, fmt::format("\"{}\" is not a finite number", parts[i]),
                    where);
      }
      parameters.push_back(*number);
    }
    if (!id || !width || !height || *width < 1 || *height < 1 || *width > kMaxSide_px ||
        *height > kMaxSide_px || parameters.size() != model->parameters) {
      return fail(ErrorCode::corrupt,
                  fmt::format("a {} camera needs: id, {}, width, height, {} parameters",
                              model->name, model->name, model->parameters),
                  where);
    }
    Expected<Camera> camera = colmap_camera(model->name, parameters, where);
    if (!camera) return tl::unexpected(camera.error());
    camera->width_px = static_cast<int>(*width);
    camera->height_px = static_cast<int>(*height);
    if (const auto checked = check_camera(*camera, where); !checked) {
      return tl::unexpected(checked.error());
    }
    cameras.push_back({static_cast<int>(*id), *camera});
  }
  if (cameras.empty()) return fail(ErrorCode::corrupt, "the file lists no camera", path);
  return cameras;
}

// The format of DSO: "[Model] fx fy cx cy distortion...", "width height", how to rectify, output
// size. Without a model's name: five numbers are FOV. If cx and cy are below 1 all four are shares
// of the image size, with (0, 0) at the corner of the first pixel.
Expected<Calibration> parse_mono_vo_camera(std::string_view text, const std::string& path) {
  const std::vector<TextLine> lines = data_lines(text);
  const auto broken = [&](const TextLine& line, std::string what) {
    return fail(ErrorCode::corrupt, std::move(what), at_line(path, line.number),
                "expected \"[FOV|RadTan|EquiDistant|Pinhole] fx fy cx cy distortion...\" and then "
                "\"width height\"");
  };
  if (lines.size() < 2) return fail(ErrorCode::corrupt, "the camera file ends too early", path);
  std::string_view numbers_text = lines[0].text;
  std::string name;
  if (const auto parts = fields(numbers_text); !parts.empty() && !to_number(parts[0])) {
    name = lower_case(parts[0]);
    if (name.ends_with(':')) name.pop_back();
    numbers_text.remove_prefix(parts[0].size());
  }
  const auto numbers = to_numbers(numbers_text);
  const auto size = to_numbers(lines[1].text);
  if (!numbers || numbers->size() < 4) return broken(lines[0], "this is not a row of intrinsics");
  if (!size || size->size() != 2 || !((*size)[0] >= 1) || !((*size)[1] >= 1) ||
      (*size)[0] > kMaxSide_px || (*size)[1] > kMaxSide_px) {
    return broken(lines[1], "this is not an image size");
  }
  Calibration result;
  result.format = "TUM monoVO camera.txt";
  Camera& camera = result.camera;
  camera.width_px = static_cast<int>((*size)[0]);
  camera.height_px = static_cast<int>((*size)[1]);
  camera.fx_px = (*numbers)[0];
  camera.fy_px = (*numbers)[1];
  camera.cx_px = (*numbers)[2];
  camera.cy_px = (*numbers)[3];
  if (camera.cx_px < 1 && camera.cy_px < 1) {
    camera.fx_px *= camera.width_px;
    camera.fy_px *= camera.height_px;
    camera.cx_px = camera.cx_px * camera.width_px - kHalf_px;
    camera.cy_px = camera.cy_px * camera.height_px - kHalf_px;
  }
  const std::span<const double> rest(numbers->data() + 4, numbers->size() - 4);
  if (name.empty()) name = rest.size() == 1 ? "fov" : rest.empty() ? "pinhole" : "radtan";
  if (name == "fov" && rest.size() == 1) {
    camera.model = rest[0] == 0 ? CameraModel::pinhole : CameraModel::fov;
    camera.distortion[0] = rest[0];
  } else if ((name == "equidistant" || name == "kannalabrandt") && rest.size() == 4) {
    camera.model = CameraModel::equidistant;
    std::copy(rest.begin(), rest.end(), camera.distortion.begin());
  } else if (name == "radtan" && rest.size() >= 4) {
    if (const auto set = set_radtan(camera, rest, at_line(path, lines[0].number)); !set) {
      return tl::unexpected(set.error());
    }
  } else if (name != "pinhole" || rest.size() > 1) {  // DSO writes a zero behind a pinhole
    const std::vector<std::string> names = {"FOV", "RadTan", "EquiDistant", "KannalaBrandt",
                                            "Pinhole"};
    const std::string nearest = nearest_hint(name, names);
    return broken(lines[0], fmt::format("\"{}\" with {} distortion values is not known{}", name,
                                        rest.size(), nearest.empty() ? "" : ": " + nearest));
  }
  return result;
}

Expected<Calibration> parse_matrix_camera(std::string_view text, std::string_view distortion,
                                          const std::string& path) {
  std::vector<double> k, d;
  for (const TextLine& line : data_lines(text)) {
    const auto row = to_numbers(line.text);
    if (!row) {
      return fail(ErrorCode::corrupt, "this is not a row of finite numbers",
                  at_line(path, line.number));
    }
    k.insert(k.end(), row->begin(), row->end());
  }
  for (const TextLine& line : data_lines(distortion)) {
    const auto row = to_numbers(line.text);
    if (!row) {
      return fail(ErrorCode::corrupt, "D.txt has something that is not a finite number",
                  at_line(path, line.number));
    }
    d.insert(d.end(), row->begin(), row->end());
  }
  if (k.size() != 9 || std::abs(k[8] - 1) > 1e-9 || k[3] != 0 || k[6] != 0 || k[7] != 0) {
    return fail(ErrorCode::corrupt, "this is not a camera matrix (fx 0 cx; 0 fy cy; 0 0 1)", path);
  }
  Calibration result;
  result.format = "camera matrix";
  result.camera.fx_px = k[0];
  result.camera.fy_px = k[4];
  result.camera.cx_px = k[2];
  result.camera.cy_px = k[5];
  if (k[1] != 0)
    result.notes.push_back(fmt::format("the skew of {} px in {} is ignored", k[1], path));
  if (const auto set = set_radtan(result.camera, d, path); !set) return tl::unexpected(set.error());
  return result;
}

}  // namespace corvid
