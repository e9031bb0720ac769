#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "io/atomic_file.h"
#include "io/exif.h"
#include "io/readers/readers.h"
#include "io/readers/text.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

constexpr double kRate_hz = 30;
constexpr double kStillsGap_s = 0.8;  // photographs are at least this far apart

using Times = std::vector<std::int64_t>;

bool rises(const Times& times) {
  return std::adjacent_find(times.begin(), times.end(), std::greater_equal<>()) == times.end();
}

// Names that are times: 13, 16 or 19 digits (ms, us, ns since 1970) or decimal seconds.
std::optional<Times> times_from_names(const std::vector<ImageEntry>& entries) {
  Times times;
  for (const ImageEntry& entry : entries) {
    const std::string stem = fs::path(entry.name).stem().string();
    std::optional<std::int64_t> time;
    if (stem.size() == 13 || stem.size() == 16 || stem.size() == 19) {
      time = to_integer(stem);
      for (std::size_t digits = stem.size(); time && digits < 19; digits += 3) {
        if (__builtin_mul_overflow(*time, std::int64_t{1000}, &*time)) time.reset();
      }
    }
    if (!time && stem.find('.') != std::string::npos && stem.find_first_of("eE") == stem.npos) {
      time = seconds_to_ns(stem);
    }
    if (!time) return {};
    times.push_back(*time);
  }
  return times;
}

// One row per image: its time in seconds, alone or behind the image's name or number.
std::optional<Times> times_from_file(const std::vector<fs::path>& places, std::size_t count,
                                     ImageList& list) {
  for (const fs::path& place : places) {
    for (const char* name : {"times.txt", "timestamps.txt"}) {
      const fs::path path = place / name;
      if (!is_file(path)) continue;
      const auto text = read_file_bytes(path);
      if (!text) continue;
      Times times;
      for (const TextLine& line : data_lines(*text)) {
        const auto parts = fields(line.text);
        const auto time =
            parts.empty() ? std::nullopt : seconds_to_ns(parts[parts.size() > 1 ? 1 : 0]);
        if (time) times.push_back(*time);
      }
      if (times.size() == count) return times;
      list.notes.push_back(fmt::format("{} is not used: it has {} times for {} images",
                                       path.string(), times.size(), count));
    }
  }
  return {};
}

// EXIF times are often whole seconds: images of one second share it evenly.
void spread_equal(Times& times) {
  for (std::size_t i = 0; i < times.size();) {
    std::size_t end = i + 1;
    while (end < times.size() && times[end] == times[i]) ++end;
    const auto n = static_cast<std::int64_t>(end - i);
    for (std::size_t k = i + 1; k < end; ++k) {
      times[k] += static_cast<std::int64_t>(k - i) * 1'000'000'000 / n;
    }
    i = end;
  }
}

// Reads all EXIF heads if the first has something to say; says what was found in notes.
std::optional<Times> times_from_exif(ImageList& list) {
  const auto first = std::find_if(list.entries.begin(), list.entries.end(), [](const auto& e) {
    const std::string lower = lower_case(e.name);
    return lower.ends_with(".jpg") || lower.ends_with(".jpeg");
  });
  if (first == list.entries.end()) return {};
  if (const auto exif = read_exif(first->path); !exif || (!exif->time_ns && !exif->gps)) {
    return {};
  }
  Times times;
  std::size_t with_gps = 0;
  for (const ImageEntry& entry : list.entries) {
    const std::optional<Exif> exif = read_exif(entry.path);
    if (exif && exif->time_ns) times.push_back(*exif->time_ns);
    if (exif && exif->gps) ++with_gps;
  }
  if (with_gps > 0) {
    list.notes.push_back(fmt::format("GPS positions in the EXIF of {} images", with_gps));
  }
  if (times.size() != list.entries.size()) return {};
  spread_equal(times);
  if (!rises(times)) {
    list.notes.emplace_back(
        "the EXIF times are not used: they do not rise in the order of the file names");
    return {};
  }
  return times;
}

double median_gap_s(Times times) {
  if (times.size() < 2) return 0;
  for (std::size_t i = times.size() - 1; i > 0; --i) times[i] -= times[i - 1];
  const auto middle = times.begin() + 1 + static_cast<std::ptrdiff_t>((times.size() - 1) / 2);
  std::nth_element(times.begin() + 1, middle, times.end());
  return static_cast<double>(*middle) * 1e-9;
}

// poses.txt with a row per image: 6 numbers (axis-angle and translation, camera from world) or 12
// (3x4, world from camera).
void take_poses(const std::vector<fs::path>& places, ImageList& list) {
  for (const fs::path& place : places) {
    const std::string path = (place / "poses.txt").string();
    if (!is_file(path)) continue;
    const auto text = read_file_bytes(path);
    if (!text) continue;
    std::vector<Pose> poses;
    for (const TextLine& line : data_lines(*text)) {
      const auto v = to_numbers(line.text);
      std::optional<Pose> pose;
      if (v && v->size() == 6) {
        const Eigen::Vector3d phi((*v)[0], (*v)[1], (*v)[2]);
        pose = Pose(so3_exp(phi), {(*v)[3], (*v)[4], (*v)[5]}).inverse();
      } else if (v && v->size() == 12) {
        const std::vector<double>& m = *v;
        const std::array<double, 9> R = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]};
        pose = pose_from_rows(R, {m[3], m[7], m[11]});
      }
      if (!pose || !pose->finite()) {
        list.notes.push_back(
            fmt::format("the true poses are left out: {}: expected 6 numbers (axis-angle and "
                        "translation) or 12 (3x4 matrix)",
                        at_line(path, line.number)));
        return;
      }
      poses.push_back(*pose);
    }
    if (poses.size() != list.entries.size()) {
      list.notes.push_back(fmt::format("{} is not used: it has {} poses for {} images", path,
                                       poses.size(), list.entries.size()));
      return;
    }
    for (std::size_t i = 0; i < poses.size(); ++i) list.entries[i].T_world_camera = poses[i];
    return;
  }
}

}  // namespace

bool recognises_image_folder(const fs::path& folder) { return !find_images_folder(folder).empty(); }

Expected<ImageList> read_image_folder(const fs::path& folder) {
  ImageList list;
  list.kind = "image folder";
  const fs::path images = find_images_folder(folder);
  for (const std::string& name : image_names(images)) {
    list.entries.push_back({(images / name).string(), 0, name, {}, nullptr});
  }
  std::vector<fs::path> places = {images};
  const fs::path absolute = fs::absolute(images).lexically_normal();
  if (images != folder) {
    places.push_back(folder);
  } else if (is_images_folder_name(absolute.filename().string())) {
    places.push_back(absolute.parent_path());  // set/images was given instead of set
  }
  if (auto ok = find_calibration(places, list); !ok) return tl::unexpected(ok.error());

  std::optional<Times> times = times_from_file(places, list.entries.size(), list);
  if (!times) times = times_from_names(list.entries);
  std::optional<Times> exif_times = times_from_exif(list);
  if (!times) times = std::move(exif_times);
  list.stills = are_photographs(list.entries) || (times && median_gap_s(*times) >= kStillsGap_s);
  if (times) {
    for (std::size_t i = 0; i < times->size(); ++i) list.entries[i].time_ns = (*times)[i];
  } else {
    set_times_by_index(list, kRate_hz);
  }
  take_poses(places, list);
  return list;
}

}  // namespace corvid
