#include <fmt/format.h>

#include <algorithm>
#include <array>

#include "io/atomic_file.h"
#include "io/readers/readers.h"
#include "io/readers/text.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

constexpr double kRate_hz = 30;

std::vector<std::string> frame_names(const fs::path& folder) {
  std::vector<std::string> names = image_names(folder);
  std::erase_if(names, [](const std::string& name) {
    return !name.starts_with("frame-") || name.find(".color.") == std::string::npos;
  });
  return names;
}

// The folder itself, its data/, or its only seq-NN.
std::vector<fs::path> frame_folders(const fs::path& folder) {
  std::vector<fs::path> result;
  if (!frame_names(folder).empty()) return {folder};
  for (const std::string& name : folder_names(folder)) {
    if ((name == "data" || name.starts_with("seq")) && !frame_names(folder / name).empty()) {
      result.push_back(folder / name);
    }
  }
  return result;
}

// 4x4, camera to world. Frames whose pose is unknown have infinities or no file.
std::optional<Pose> read_pose(const fs::path& path) {
  if (!is_file(path)) return {};
  const auto text = read_file_bytes(path);
  if (!text) return {};
  std::vector<double> m;
  for (const TextLine& line : data_lines(*text)) {
    const auto row = to_numbers(line.text);
    if (!row) return {};
    m.insert(m.end(), row->begin(), row->end());
  }
  if (m.size() != 16) return {};
  const std::array<double, 9> R = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]};
  return pose_from_rows(R, {m[3], m[7], m[11]});
}

}  // namespace

bool recognises_seven_scenes(const fs::path& folder) { return !frame_folders(folder).empty(); }

fs::path seven_scenes_frames(const fs::path& folder) { return frame_folders(folder).front(); }

Expected<ImageList> read_seven_scenes(const fs::path& given) {
  const std::vector<fs::path> folders = frame_folders(given);
  if (folders.size() > 1) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("this is a collection of {} sequences", folders.size()), given.string(),
                "choose one, for example " + folders.front().string());
  }
  const fs::path& folder = folders.front();
  ImageList list;
  list.kind = "7-Scenes";
  std::size_t unknown = 0;
  const std::vector<NumberedName> names = fill_gaps(frame_names(folder));
  for (const NumberedName& n : names) {
    const std::string stem = n.name.substr(0, n.name.find('.'));
    const std::optional<Pose> pose = read_pose(folder / (stem + ".pose.txt"));
    if (!pose) ++unknown;
    // By its number: a gap takes its time too.
    const std::int64_t time =
        (n.number - names.front().number) * 1'000'000'000 / static_cast<std::int64_t>(kRate_hz);
    list.entries.push_back({(folder / n.name).string(), time, n.name, pose, nullptr});
    list.has_depth |= is_file(folder / (stem + ".depth.png"));
  }
  list.notes.push_back(fmt::format("the images have no times: {} Hz is assumed", kRate_hz));
  if (unknown > 0) {
    list.notes.push_back(fmt::format("{} of {} images have no true pose", unknown, names.size()));
  }
  const std::array places = {folder, given, folder / ".."};
  if (auto ok = find_calibration(places, list); !ok) return tl::unexpected(ok.error());
  const bool depth_camera = list.calibration && list.calibration->format == "camera matrix" &&
                            list.calibration->camera.fx_px == 585 &&
                            list.calibration->camera.fy_px == 585;
  if (!list.calibration || depth_camera) {
    list.calibration.emplace();
    list.calibration->camera = {CameraModel::pinhole, 640, 480, 525, 525, 319.5, 239.5, {}};
    list.origin = IntrinsicsOrigin::nominal;
    list.notes.emplace_back(
        depth_camera
            ? "the given focal length of 585 px is the depth camera's: the Kinect's nominal 525 px "
              "is used for colour; give a calibration file if you have a better one"
            : "no calibration: the Kinect's nominal focal length of 525 px is used");
  }
  return list;
}

}  // namespace corvid
