#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>

#include "io/atomic_file.h"
#include "io/nearest_name.h"
#include "io/readers/readers.h"
#include "io/readers/text.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

constexpr double kRate_hz = 10;

bool is_sequence(const fs::path& folder) {
  return is_file(folder / "calib.txt") &&
         (is_folder(folder / "image_0") || is_folder(folder / "image_2"));
}

bool is_root(const fs::path& folder) {
  for (const std::string& name : folder_names(folder / "sequences")) {
    if (is_sequence(folder / "sequences" / name)) return true;
  }
  return false;
}

using Projection = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

// P = K (I | b): the projection of points in camera 0 (Geiger et al., "Vision meets Robotics", 4).
Expected<Projection> read_projection(const std::string& path, const std::string& key) {
  const auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  std::vector<std::string> keys;
  for (const TextLine& line : data_lines(*text)) {
    const std::size_t colon = std::min(line.text.find(':'), line.text.size());
    keys.emplace_back(trim(line.text.substr(0, colon)));
    if (keys.back() != key) continue;
    const auto numbers = to_numbers(line.text.substr(std::min(colon + 1, line.text.size())));
    if (!numbers || numbers->size() != 12) {
      return fail(ErrorCode::corrupt, key + " needs 12 finite numbers", at_line(path, line.number));
    }
    const Projection P = Eigen::Map<const Projection>(numbers->data());
    if (!(P(0, 0) > 0) || !(P(1, 1) > 0) || P(0, 1) != 0 || P(2, 2) != 1) {
      return fail(ErrorCode::corrupt, key + " is not K (I | b) of a rectified camera",
                  at_line(path, line.number));
    }
    return P;
  }
  const std::string nearest = nearest_name(key, keys);
  return fail(ErrorCode::corrupt, fmt::format("key \"{}\" is missing", key), path,
              nearest.empty() ? fmt::format("keys found: {}", fmt::join(keys, ", "))
                              : fmt::format("the nearest that the file has is \"{}\"", nearest));
}

// Row of image `i` in a file with one row per image of the sequence: by the image's number where
// the file reaches that far, else by position (files that were cut together with the images).
std::optional<std::size_t> row_of(const std::vector<NumberedName>& names, std::size_t i,
                                  std::size_t rows) {
  const auto last = static_cast<std::size_t>(std::max<std::int64_t>(names.back().number, 0));
  const std::size_t row = rows > last ? static_cast<std::size_t>(names[i].number) : i;
  return row < rows ? std::optional(row) : std::nullopt;
}

// Times of all images; an image without a row is dropped with a message.
Expected<void> take_times(const fs::path& folder, const std::vector<NumberedName>& names,
                          ImageList& list) {
  const std::string path = (folder / "times.txt").string();
  if (!is_file(path)) {
    set_times_by_index(list, kRate_hz);
    return {};
  }
  const auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  const std::vector<TextLine> lines = data_lines(*text);
  if (lines.empty()) return fail(ErrorCode::corrupt, "the file has no times", path);
  std::vector<ImageEntry> timed;
  for (std::size_t i = 0; i < list.entries.size(); ++i) {
    const auto row = row_of(names, i, lines.size());
    const auto time = row ? seconds_to_ns(lines[*row].text) : std::nullopt;
    if (!time) {
      list.skipped.push_back(row ? fmt::format("{}: \"{}\" is not a time",
                                               at_line(path, lines[*row].number), lines[*row].text)
                                 : fmt::format("{}: no row for {}", path, list.entries[i].name));
      continue;
    }
    timed.push_back(std::move(list.entries[i]));
    timed.back().time_ns = *time;
  }
  if (timed.empty()) return fail(ErrorCode::corrupt, "the file has no times", path);
  list.entries = std::move(timed);
  return {};
}

void take_poses(const fs::path& folder, const std::vector<NumberedName>& names,
                const Eigen::Vector3d& camera_in_0, ImageList& list) {
  const std::string number = folder.filename().string();
  fs::path path;
  for (const fs::path& candidate :
       {folder / "poses.txt", folder / (number + ".txt"),
        folder / ".." / ".." / "poses" / (number + ".txt"), folder / ".." / (number + ".txt")}) {
    if (path.empty() && is_file(candidate)) path = candidate;
  }
  if (path.empty()) return;
  TrajectoryReadOptions options;
  options.format = TrajectoryFormat::kitti;
  const auto poses = read_trajectory(path.string(), options);
  if (!poses) {
    list.notes.push_back("the true trajectory is left out: " + poses.error().to_string());
    return;
  }
  for (std::size_t i = 0; i < list.entries.size(); ++i) {
    const auto row = row_of(names, i, poses->size());
    if (!row) continue;
    const Pose T_camera0_camera(Eigen::Quaterniond::Identity(), camera_in_0);
    list.entries[i].T_world_camera = (*poses)[*row].T_world_camera * T_camera0_camera;
  }
}

}  // namespace

bool recognises_kitti(const fs::path& folder) { return is_sequence(folder) || is_root(folder); }

Expected<ImageList> read_kitti_odometry(const fs::path& given) {
  fs::path folder = fs::absolute(given).lexically_normal();
  if (folder.filename().empty()) folder = folder.parent_path();
  if (!is_sequence(folder)) {
    std::vector<std::string> names = folder_names(folder / "sequences");
    std::erase_if(names,
                  [&](const std::string& n) { return !is_sequence(folder / "sequences" / n); });
    if (names.size() > 1) {
      return fail(ErrorCode::invalid_argument,
                  fmt::format("this is a collection of {} KITTI sequences", names.size()),
                  folder.string(),
                  fmt::format("choose one, for example {}",
                              (folder / "sequences" / names.front()).string()));
    }
    folder = folder / "sequences" / names.front();
  }
  ImageList list;
  list.kind = "KITTI odometry";
  const bool grey = !image_names(folder / "image_0").empty();
  const fs::path images = folder / (grey ? "image_0" : "image_2");
  const std::vector<NumberedName> names = fill_gaps(image_names(images));
  if (names.empty()) {
    return fail(ErrorCode::not_found, "the folder has no images", images.string(),
                "image_0 (grey) or image_2 (colour) must hold 000000.png and so on");
  }
  for (const NumberedName& n : names) {
    list.entries.push_back({(images / n.name).string(), 0, n.name, {}, nullptr});
  }
  const std::string calib = (folder / "calib.txt").string();
  const auto P = read_projection(calib, grey ? "P0" : "P2");
  if (!P) return tl::unexpected(P.error());
  list.calibration.emplace();
  list.calibration->format = "KITTI calib.txt";
  list.calibration_path = calib;
  Camera& camera = list.calibration->camera;
  camera.fx_px = (*P)(0, 0), camera.fy_px = (*P)(1, 1);
  camera.cx_px = (*P)(0, 2), camera.cy_px = (*P)(1, 2);
  // x_camera = x_0 + K^-1 b, so the camera sits at -K^-1 b in camera 0.
  const Eigen::Vector3d offset = -(P->leftCols<3>().inverse() * P->col(3));
  if (!offset.allFinite()) return fail(ErrorCode::corrupt, "K cannot be inverted", calib);
  take_poses(folder, names, offset, list);
  if (auto ok = take_times(folder, names, list); !ok) return tl::unexpected(ok.error());
  if (is_folder(folder / (grey ? "image_1" : "image_3"))) {
    list.notes.emplace_back("the second camera of the stereo pair is not used");
  }
  return list;
}

}  // namespace corvid
