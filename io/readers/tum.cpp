#include <fmt/format.h>

#include <array>
#include <map>

#include "io/atomic_file.h"
#include "io/readers/readers.h"
#include "io/readers/text.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

struct Kinect {
  std::array<std::string_view, 2> names;
  double fx, fy, cx, cy;
  std::array<double, 5> distortion;
};
// "Intrinsic Camera Calibration of the Kinect", TUM RGB-D benchmark, file formats page (RGB).
constexpr std::array kKinects = {
    Kinect{{"freiburg1", "fr1"},
           517.3,
           516.5,
           318.6,
           255.3,
           {0.2624, -0.9531, -0.0054, 0.0026, 1.1633}},
    Kinect{{"freiburg2", "fr2"},
           520.9,
           521.0,
           325.1,
           249.7,
           {0.2312, -0.7849, -0.0033, -0.0001, 0.9172}},
    Kinect{{"freiburg3", "fr3"}, 535.4, 539.2, 320.1, 247.6, {0, 0, 0, 0, 0}},
};
// The same page's default, for recordings that say nothing of their camera.
constexpr Kinect kDefault{{"", ""}, 525.0, 525.0, 319.5, 239.5, {0, 0, 0, 0, 0}};

void take_kinect(const fs::path& folder, ImageList& list) {
  const std::string name = lower_case(fs::absolute(folder).lexically_normal().string());
  const Kinect* kinect = &kDefault;
  for (const Kinect& known : kKinects) {
    for (const std::string_view part : known.names) {
      if (name.find(part) != std::string::npos) kinect = &known;
    }
  }
  list.calibration.emplace();
  list.calibration->format = "TUM RGB-D default";
  Camera& camera = list.calibration->camera;
  camera = {CameraModel::pinhole, 640,        480,        kinect->fx,
            kinect->fy,           kinect->cx, kinect->cy, kinect->distortion};
  if (kinect->distortion[0] != 0) camera.model = CameraModel::radtan;
  if (kinect == &kDefault) {
    list.origin = IntrinsicsOrigin::nominal;
    list.notes.emplace_back(
        "no calibration file and neither freiburg1, 2 nor 3 in the name: the Kinect's nominal "
        "focal length of 525 px is used");
  } else {
    list.notes.push_back(fmt::format(
        "no calibration file: the published intrinsics of {} are used, after the folder's name",
        kinect->names[0]));
  }
}

}  // namespace

bool recognises_tum_rgbd(const fs::path& folder) { return is_file(folder / "rgb.txt"); }

Expected<ImageList> read_tum_rgbd(const fs::path& folder) {
  ImageList list;
  list.kind = "TUM RGB-D";
  const std::string path = (folder / "rgb.txt").string();
  const auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  for (const TextLine& line : data_lines(*text)) {
    const std::size_t blank = std::min(line.text.find_first_of(" \t,"), line.text.size());
    const auto time = seconds_to_ns(line.text.substr(0, blank));
    const std::string name(trim(line.text.substr(std::min(blank + 1, line.text.size()))));
    if (!time || name.empty() || name.find('\0') != std::string::npos) {
      list.skipped.push_back(fmt::format("{}: expected \"time file\"", at_line(path, line.number)));
      continue;
    }
    list.entries.push_back(
        {(folder / name).string(), *time, fs::path(name).filename().string(), {}, nullptr});
  }
  if (list.entries.empty()) {
    return fail(ErrorCode::corrupt,
                list.skipped.empty() ? "the file lists no image"
                                     : fmt::format("the file lists no image; {}", list.skipped[0]),
                path, "each row is \"time file\"");
  }
  list.has_depth = is_file(folder / "depth.txt");
  if (is_file(folder / "groundtruth.txt")) add_truth(folder / "groundtruth.txt", list);
  if (auto ok = find_calibration(std::array{folder}, list); !ok) return tl::unexpected(ok.error());
  if (!list.calibration) take_kinect(folder, list);
  return list;
}

bool recognises_mono_vo(const fs::path& folder) {
  return is_file(folder / "camera.txt") && is_file(folder / "times.txt") &&
         (is_folder(folder / "images") || is_file(folder / "images.zip"));
}

Expected<ImageList> read_mono_vo(const fs::path& folder) {
  ImageList list;
  list.kind = "TUM monoVO";
  const fs::path images = folder / "images";
  if (!is_folder(images)) {
    return fail(ErrorCode::unsupported, "the images are still packed",
                (folder / "images.zip").string(),
                fmt::format("unzip {} -d {}", (folder / "images.zip").string(), images.string()));
  }
  list.calibration_path = (folder / "camera.txt").string();
  auto calibration = read_calibration(list.calibration_path);
  if (!calibration) return tl::unexpected(calibration.error());
  list.calibration = std::move(*calibration);

  std::map<std::string, std::string> by_stem;
  for (const std::string& name : image_names(images)) {
    by_stem.emplace(fs::path(name).stem().string(), name);
  }
  const std::string path = (folder / "times.txt").string();
  const auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  for (const TextLine& line : data_lines(*text)) {
    const auto parts = fields(line.text);
    const auto time = parts.size() == 2 || parts.size() == 3 ? seconds_to_ns(parts[1])
                                                             : std::optional<std::int64_t>();
    if (!time || parts[0].find('\0') != std::string_view::npos) {
      list.skipped.push_back(
          fmt::format("{}: expected \"id time exposure\"", at_line(path, line.number)));
      continue;
    }
    const auto found = by_stem.find(std::string(parts[0]));
    const std::string name =
        found == by_stem.end() ? std::string(parts[0]) + ".jpg" : found->second;
    list.entries.push_back({(images / name).string(), *time, name, {}, nullptr});
  }
  if (list.entries.empty()) {
    return fail(ErrorCode::corrupt,
                list.skipped.empty() ? "the file lists no image"
                                     : fmt::format("the file lists no image; {}", list.skipped[0]),
                path, "each row is \"id time exposure\"");
  }
  if (is_file(folder / "pcalib.txt") || is_file(folder / "vignette.png")) {
    list.notes.emplace_back("the photometric calibration (pcalib.txt, vignette.png) is not used");
  }
  if (is_file(folder / "groundtruthSync.txt")) {
    list.notes.emplace_back(
        "groundtruthSync.txt is not used: it covers the start and the end of the recording only");
  }
  return list;
}

}  // namespace corvid
