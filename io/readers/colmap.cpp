#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "io/atomic_file.h"
#include "io/readers/calibration_formats.h"
#include "io/readers/readers.h"
#include "io/readers/text.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

constexpr double kRate_hz = 30;

fs::path model_folder(const fs::path& folder) {
  for (const fs::path& candidate :
       {folder, folder / "sparse", folder / "sparse" / "0", folder / "dense" / "sparse"}) {
    if (is_file(candidate / "cameras.txt") && is_file(candidate / "images.txt")) return candidate;
  }
  return {};
}

// Where the first image of the model lies.
fs::path images_root(const fs::path& folder, const fs::path& model, const std::string& name) {
  for (const fs::path& candidate :
       {folder / "images", model / "images", model / ".." / "images",
        model / ".." / ".." / "images", folder / ".." / "images", folder, model / ".."}) {
    if (is_file(candidate / name)) return candidate.lexically_normal();
  }
  return folder / "images";
}

// "id qw qx qy qz tx ty tz camera name", camera from world; the name is the rest of the row.
struct ImageRow {
  Pose T_world_camera;
  std::int64_t camera = 0;
  std::string name;
};
std::optional<ImageRow> parse_row(std::string_view line) {
  std::array<std::string_view, 9> head;
  for (std::string_view& field : head) {
    const std::size_t blank = line.find_first_of(" \t");
    if (blank == std::string_view::npos) return {};
    field = line.substr(0, blank);
    line = trim(line.substr(blank));
  }
  std::array<double, 7> v{};
  for (std::size_t i = 0; i < 7; ++i) {
    const auto number = to_number(head[i + 1]);
    if (!number) return {};
    v[i] = *number;
  }
  const auto camera = to_integer(head[8]);
  const Eigen::Quaterniond q(v[0], v[1], v[2], v[3]);
  if (!to_integer(head[0]) || !camera || line.empty() || std::abs(q.norm() - 1) > 0.05 ||
      line.find('\0') != std::string_view::npos) {
    return {};
  }
  return ImageRow{Pose(q, {v[4], v[5], v[6]}).inverse(), *camera, std::string(line)};
}

}  // namespace

bool recognises_colmap(const fs::path& folder) { return !model_folder(folder).empty(); }

Expected<ImageList> read_colmap(const fs::path& folder) {
  ImageList list;
  list.kind = "COLMAP text model";
  const fs::path model = model_folder(folder);
  list.calibration_path = (model / "cameras.txt").string();
  const auto camera_text = read_file_bytes(list.calibration_path);
  if (!camera_text) return tl::unexpected(camera_text.error());
  const auto cameras = parse_colmap_cameras(*camera_text, list.calibration_path);
  if (!cameras) return tl::unexpected(cameras.error());
  std::map<std::int64_t, std::shared_ptr<const Camera>> by_id;
  for (const ColmapCamera& c : *cameras) by_id[c.id] = std::make_shared<const Camera>(c.camera);

  const std::string path = (model / "images.txt").string();
  const auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  bool points_row = false;  // every image row is followed by one of its points, which may be blank
  for (const TextLine& line : data_lines(*text, true)) {
    if (points_row) {
      points_row = false;
      continue;
    }
    if (line.text.empty()) continue;
    points_row = true;
    const std::optional<ImageRow> row = parse_row(line.text);
    const auto camera = row ? by_id.find(row->camera) : by_id.end();
    if (camera == by_id.end()) {
      list.skipped.push_back(
          row ? fmt::format("{}: there is no camera {}", at_line(path, line.number), row->camera)
              : fmt::format("{}: expected \"id qw qx qy qz tx ty tz camera name\"",
                            at_line(path, line.number)));
      continue;
    }
    list.entries.push_back({"", 0, row->name, row->T_world_camera, camera->second});
  }
  if (list.entries.empty()) {
    return fail(ErrorCode::corrupt,
                list.skipped.empty() ? "the model has no images"
                                     : fmt::format("the model has no images; {}", list.skipped[0]),
                path);
  }
  std::stable_sort(
      list.entries.begin(), list.entries.end(),
      [](const ImageEntry& a, const ImageEntry& b) { return natural_less(a.name, b.name); });
  const fs::path images = images_root(folder, model, list.entries.front().name);
  for (ImageEntry& entry : list.entries) entry.path = (images / entry.name).string();
  list.stills = are_photographs(list.entries);
  set_times_by_index(list, kRate_hz);
  return list;
}

}  // namespace corvid
