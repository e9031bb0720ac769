#include <fmt/format.h>

#include <array>

#include "io/atomic_file.h"
#include "io/readers/readers.h"
#include "io/readers/text.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

// The folder that holds cam0, whether the recording, its mav0 or its cam0 is given.
fs::path sensors_folder(const fs::path& folder) {
  if (is_folder(folder / "mav0")) return folder / "mav0";
  if (is_file(folder / "cam0" / "data.csv") || is_file(folder / "cam0" / "sensor.yaml")) {
    return folder;
  }
  if (is_file(folder / "data.csv") &&
      (is_folder(folder / "data") || is_file(folder / "sensor.yaml"))) {
    return fs::absolute(folder / "..").lexically_normal();
  }
  return {};
}

Expected<void> read_image_rows(const fs::path& cam, ImageList& list) {
  const fs::path csv = cam / "data.csv";
  const auto text = read_file_bytes(csv);
  if (!text) return tl::unexpected(text.error());
  bool first = true;
  const std::vector<TextLine> lines = data_lines(*text);
  for (const TextLine& line : lines) {
    const std::size_t comma = std::min(line.text.find(','), line.text.size());
    const std::string_view time_text = trim(line.text.substr(0, comma));
    const auto time = to_integer(time_text);
    std::string name(trim(line.text.substr(std::min(comma + 1, line.text.size()))));
    // A recording that was killed may end within a line: it is none unless its image is there.
    if (&line == &lines.back() && !text->ends_with('\n') &&
        (!time || name.empty() || !is_file(cam / "data" / name))) {
      list.notes.push_back(fmt::format("{}: the last line is cut off and left out", csv.string()));
      break;
    }
    const bool header = first && !time && time_text.find("time") != std::string_view::npos;
    first = false;
    if (header) continue;
    if (!time || *time < 0 || name.find('\0') != std::string::npos) {
      list.skipped.push_back(
          fmt::format("{}: expected \"time_ns,file name\"", at_line(csv.string(), line.number)));
      continue;
    }
    if (name.empty()) name = fmt::format("{}.png", *time);
    list.entries.push_back({(cam / "data" / name).string(), *time, name, {}, nullptr});
  }
  if (list.entries.empty()) {
    return fail(ErrorCode::corrupt,
                list.skipped.empty() ? "the file lists no image"
                                     : fmt::format("the file lists no image; {}", list.skipped[0]),
                csv.string(), "each row is \"time in ns,file name\"");
  }
  return {};
}

}  // namespace

bool recognises_asl(const fs::path& folder) { return !sensors_folder(folder).empty(); }

Expected<ImageList> read_asl(const fs::path& folder) {
  const fs::path root = sensors_folder(folder);
  fs::path cam = root / "cam0";
  if (!is_folder(cam) && is_file(folder / "data.csv")) cam = folder;  // a camera by another name
  ImageList list;
  list.kind = "EuRoC/ASL";
  if (auto ok = read_image_rows(cam, list); !ok) return tl::unexpected(ok.error());

  const fs::path sensor = cam / "sensor.yaml";
  if (is_file(sensor)) {
    auto calibration = read_calibration(sensor.string());
    if (!calibration) return tl::unexpected(calibration.error());
    list.calibration = std::move(*calibration);
    list.calibration_path = sensor.string();
  } else {
    const std::array<fs::path, 4> places = {cam, root, root / "..", root / ".." / "dso"};
    if (auto ok = find_calibration(places, list); !ok) return tl::unexpected(ok.error());
  }

  for (const char* name : {"state_groundtruth_estimate0", "mocap0"}) {
    const fs::path truth = root / name / "data.csv";
    if (!is_file(truth)) continue;
    if (!list.calibration || !list.calibration->T_body_camera) {
      list.notes.emplace_back(
          "the true trajectory is left out: it is the body's, and nothing says where the camera "
          "sits on the body (T_BS)");
      break;
    }
    add_truth(truth, list);
    // The file has T_world_body; T_BS takes the camera to the body.
    for (StampedPose& pose : list.truth) {
      pose.T_world_camera = pose.T_world_camera * *list.calibration->T_body_camera;
    }
    break;
  }
  if (is_folder(root / "cam1")) list.notes.emplace_back("a second camera (cam1) is not used");
  return list;
}

}  // namespace corvid
