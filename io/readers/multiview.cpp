#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "io/atomic_file.h"
#include "io/image_file.h"
#include "io/readers/calibration_formats.h"
#include "io/readers/readers.h"
#include "io/readers/text.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

// One camera object for all images that share the values.
class CameraPool {
 public:
  std::shared_ptr<const Camera> get(const Camera& camera) {
    for (const auto& known : known_) {
      if (*known == camera) return known;
    }
    return known_.emplace_back(std::make_shared<const Camera>(camera));
  }

 private:
  std::vector<std::shared_ptr<const Camera>> known_;
};

// K row by row; nothing if it is no camera matrix.
std::optional<Camera> camera_from_rows(std::span<const double> k) {
  Camera camera;
  if (k.size() != 9 || k[3] != 0 || k[6] != 0 || k[7] != 0 || std::abs(k[8] - 1) > 1e-9) return {};
  camera.fx_px = k[0], camera.fy_px = k[4], camera.cx_px = k[2], camera.cy_px = k[5];
  if (!check_camera(camera, "")) return {};
  return camera;
}

std::string par_file(const fs::path& folder) {
  for (const std::string& name : file_names(folder)) {
    if (name.ends_with("_par.txt")) return name;
  }
  return {};
}

fs::path camera_files_folder(const fs::path& folder) {
  for (const fs::path& candidate : {folder, folder / "gt_dense_cameras", folder / "cameras",
                                    folder / "images", folder / ".." / "gt_dense_cameras"}) {
    for (const std::string& name : file_names(candidate)) {
      if (name.ends_with(".camera") && is_image_name(name.substr(0, name.size() - 7))) {
        return candidate;
      }
    }
  }
  return {};
}

// Eight or nine rows: K (3), distortion (1), R camera to world (3), centre, image size.
Expected<ImageEntry> read_camera_file(const fs::path& path, CameraPool& cameras) {
  const auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  std::vector<double> v;
  for (const TextLine& line : data_lines(*text)) {
    const auto row = to_numbers(line.text);
    if (!row) {
      return fail(ErrorCode::corrupt, "this is not a row of finite numbers",
                  at_line(path.string(), line.number));
    }
    v.insert(v.end(), row->begin(), row->end());
  }
  if (v.size() != 26) {
    return fail(ErrorCode::corrupt, fmt::format("{} numbers; expected 26", v.size()), path.string(),
                "K, distortion, R, centre and image size");
  }
  const std::span<const double> all(v);
  auto camera = camera_from_rows(all.first(9));
  const auto pose = pose_from_rows(all.subspan(12, 9), {v[21], v[22], v[23]});
  if (!camera || !pose) {
    return fail(ErrorCode::corrupt, camera ? "R is not a rotation" : "K is not a camera matrix",
                path.string());
  }
  if (v[9] != 0 || v[10] != 0 || v[11] != 0) {
    return fail(ErrorCode::unsupported, "the distortion is not zero", path.string());
  }
  if (!(v[24] >= 1 && v[25] >= 1 && v[24] < 1e6 && v[25] < 1e6)) {
    return fail(ErrorCode::corrupt, "the image size is wrong", path.string());
  }
  camera->width_px = static_cast<int>(v[24]);
  camera->height_px = static_cast<int>(v[25]);
  ImageEntry entry;
  entry.T_world_camera = pose;
  entry.camera = cameras.get(*camera);
  return entry;
}

}  // namespace

bool recognises_middlebury(const fs::path& folder) { return !par_file(folder).empty(); }

// Middlebury multi-view stereo: "name K(9) R(9) t(3)" per image with P = K (R | t).
Expected<ImageList> read_middlebury(const fs::path& folder) {
  ImageList list;
  list.kind = "Middlebury multi-view";
  list.stills = true;
  const std::string path = (folder / par_file(folder)).string();
  const auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  const std::vector<TextLine> lines = data_lines(*text);
  CameraPool cameras;
  std::optional<std::int64_t> promised;
  for (const TextLine& line : lines) {
    const auto parts = fields(line.text);
    if (&line == &lines.front() && parts.size() == 1) {
      promised = to_integer(parts[0]);
      if (promised) continue;
    }
    const std::size_t name_length = parts.empty() ? 0 : parts[0].size();
    const auto numbers = to_numbers(line.text.substr(name_length));
    const bool whole = numbers && numbers->size() == 21;
    const std::span<const double> v = whole ? std::span(*numbers) : std::span<const double>();
    const auto camera = whole ? camera_from_rows(v.first(9)) : std::nullopt;
    const auto pose = whole ? pose_from_rows(v.subspan(9, 9), {v[18], v[19], v[20]}) : std::nullopt;
    if (!camera || !pose || parts[0].find('\0') != std::string_view::npos) {
      list.skipped.push_back(
          fmt::format("{}: expected a name, K, R and t (21 numbers)", at_line(path, line.number)));
      continue;
    }
    ImageEntry entry;
    entry.name = std::string(parts[0]);
    entry.path = (folder / entry.name).string();
    entry.T_world_camera = pose->inverse();
    entry.camera = cameras.get(*camera);
    list.entries.push_back(std::move(entry));
  }
  if (list.entries.empty()) {
    return fail(ErrorCode::corrupt,
                list.skipped.empty() ? "the file lists no image"
                                     : fmt::format("the file lists no image; {}", list.skipped[0]),
                path);
  }
  const std::size_t rows = list.entries.size() + list.skipped.size();
  if (promised && static_cast<std::uint64_t>(std::max<std::int64_t>(*promised, 0)) != rows) {
    list.notes.push_back(fmt::format("{} promises {} images but lists {}", path, *promised, rows));
  }
  set_times_by_index(list, 1);
  return list;
}

bool recognises_strecha(const fs::path& folder) { return !camera_files_folder(folder).empty(); }

Expected<ImageList> read_strecha(const fs::path& folder) {
  ImageList list;
  list.kind = "Strecha multi-view";
  list.stills = true;
  const fs::path camera_folder = camera_files_folder(folder);
  fs::path images = find_images_folder(folder);
  if (images.empty()) images = folder;
  CameraPool cameras;
  for (const std::string& name : file_names(camera_folder)) {
    if (!name.ends_with(".camera")) continue;
    auto entry = read_camera_file(camera_folder / name, cameras);
    if (!entry) {
      list.skipped.push_back(entry.error().to_string());
      continue;
    }
    entry->name = name.substr(0, name.size() - 7);
    entry->path = (images / entry->name).string();
    list.entries.push_back(std::move(*entry));
  }
  if (list.entries.empty()) {
    return fail(ErrorCode::corrupt, fmt::format("no camera file can be used; {}", list.skipped[0]),
                camera_folder.string());
  }
  set_times_by_index(list, 1);
  return list;
}

}  // namespace corvid
