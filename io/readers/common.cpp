#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "io/exif.h"
#include "io/image_file.h"
#include "io/readers/readers.h"
#include "io/readers/text.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

using namespace std::string_view_literals;

constexpr std::array kImageFolders = {"images"sv, "image"sv,  "imgs"sv,  "img"sv,
                                      "frames"sv, "rgb"sv,    "color"sv, "data"sv,
                                      "cam0"sv,   "photos"sv, "left"sv,  "pictures"sv};

std::vector<std::string> names_in(const fs::path& folder, bool folders) {
  std::vector<std::string> names;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    std::error_code ignored;
    const fs::file_status status = it->status(ignored);
    // Pipes and devices would block or never end; a link to nothing is reported where it is read.
    const bool wanted =
        folders ? fs::is_directory(status) : fs::is_regular_file(status) || !fs::exists(status);
    if (wanted) {
      names.push_back(it->path().filename().string());
    }
  }
  std::sort(names.begin(), names.end(), natural_less);
  return names;
}

// Higher is better; 0: not a name that calibrations have.
int calibration_rank(const std::string& name) {
  const std::string lower = lower_case(name);
  const std::string ending = fs::path(lower).extension().string();
  if (ending == ".yaml" || ending == ".yml" || ending == ".xml") {
    if (lower.find("calib") != std::string::npos) return 9;
    if (lower.find("camchain") != std::string::npos) return 8;
    if (lower.find("camera") != std::string::npos) return 7;
    if (lower.find("intrinsic") != std::string::npos) return 6;
    if (lower.starts_with("sensor.")) return 5;
    if (lower.starts_with("ost.") || lower.starts_with("cam")) return 4;
    return 0;
  }
  if (lower == "cameras.txt") return 3;
  if (lower == "camera.txt") return 2;
  if (lower == "k.txt" || lower == "camera-intrinsics.txt") return 1;
  return 0;
}

// Splits "frame-000012.color.jpg" at its last run of digits before the ending.
struct NameParts {
  std::string prefix, digits, suffix;
};
std::optional<NameParts> split_number(const std::string& name) {
  const std::size_t dot = std::min(name.find('.'), name.size());
  const std::size_t end = name.find_last_of("0123456789", dot);
  if (end == std::string::npos) return {};
  const std::size_t before = name.find_last_not_of("0123456789", end);
  const std::size_t begin = before == std::string::npos ? 0 : before + 1;
  return NameParts{name.substr(0, begin), name.substr(begin, end + 1 - begin),
                   name.substr(end + 1)};
}

}  // namespace

bool is_file(const fs::path& path) {
  std::error_code ignored;
  return fs::is_regular_file(path, ignored);
}

bool is_folder(const fs::path& path) {
  std::error_code ignored;
  return fs::is_directory(path, ignored);
}

std::vector<std::string> file_names(const fs::path& folder) { return names_in(folder, false); }
std::vector<std::string> folder_names(const fs::path& folder) { return names_in(folder, true); }

std::vector<std::string> image_names(const fs::path& folder) {
  std::vector<std::string> names = file_names(folder);
  std::erase_if(names, [](const std::string& name) { return !is_image_name(name); });
  return names;
}

bool is_images_folder_name(const std::string& name) {
  const std::string lower = lower_case(name);
  return std::find(kImageFolders.begin(), kImageFolders.end(), lower) != kImageFolders.end();
}

fs::path find_images_folder(const fs::path& folder) {
  const std::vector<std::string> folders = folder_names(folder);
  for (const std::string_view usual : kImageFolders) {
    for (const std::string& name : folders) {
      if (lower_case(name) == usual && !image_names(folder / name).empty()) return folder / name;
    }
  }
  return image_names(folder).empty() ? fs::path() : folder;
}

Expected<void> find_calibration(std::span<const fs::path> folders, ImageList& list) {
  for (const fs::path& folder : folders) {
    std::string best;
    int best_rank = 0;
    for (const std::string& name : file_names(folder)) {
      const int rank = calibration_rank(name);
      if (rank > best_rank) best_rank = rank, best = name;
    }
    if (best.empty()) continue;
    list.calibration_path = (folder / best).string();
    auto read = read_calibration(list.calibration_path);
    if (!read) return tl::unexpected(read.error());
    list.calibration = std::move(*read);
    list.notes.push_back(
        fmt::format("camera from {} ({})", list.calibration_path, list.calibration->format));
    return {};
  }
  return {};
}

void add_truth(const fs::path& file, ImageList& list) {
  auto truth = read_trajectory(file.string());
  if (truth) {
    list.truth = std::move(*truth);
  } else {
    list.notes.push_back("the true trajectory is left out: " + truth.error().to_string());
  }
}

std::vector<NumberedName> fill_gaps(const std::vector<std::string>& names) {
  std::vector<NumberedName> result;
  std::optional<NameParts> first;
  for (std::size_t i = 0; i < names.size(); ++i) {
    const auto parts = split_number(names[i]);
    const auto number = parts ? to_integer(parts->digits) : std::nullopt;
    if (i == 0) first = parts;
    // A jump this wide is not a row of lost images; other endings are not one row.
    const bool joins =
        number && first && parts->prefix == first->prefix && parts->suffix == first->suffix &&
        (i == 0 || (*number > result.back().number && *number - result.back().number <= 1000));
    if (!joins) {
      result.clear();
      for (std::size_t k = 0; k < names.size(); ++k) {
        result.push_back({static_cast<std::int64_t>(k), names[k]});
      }
      return result;
    }
    for (std::int64_t n = result.empty() ? *number : result.back().number + 1; n < *number; ++n) {
      result.push_back({n, fmt::format("{}{:0{}d}{}", parts->prefix, n,
                                       static_cast<int>(first->digits.size()), parts->suffix)});
    }
    result.push_back({*number, names[i]});
  }
  return result;
}

bool are_photographs(const std::vector<ImageEntry>& entries) {
  const auto jpeg = std::find_if(entries.begin(), entries.end(), [](const ImageEntry& e) {
    const std::string lower = lower_case(e.path);
    return (lower.ends_with(".jpg") || lower.ends_with(".jpeg")) && is_file(e.path);
  });
  if (jpeg == entries.end()) return false;
  const std::optional<Exif> exif = read_exif(jpeg->path);
  return exif && exif->from_camera();
}

void set_times_by_index(ImageList& list, double rate_hz) {
  const double rate = list.stills ? 1.0 : rate_hz;
  for (std::size_t i = 0; i < list.entries.size(); ++i) {
    list.entries[i].time_ns =
        static_cast<std::int64_t>(std::llround(static_cast<double>(i) * 1e9 / rate));
  }
  list.notes.push_back(fmt::format("the images have no times: {} Hz is assumed", rate));
}

std::optional<Pose> pose_from_rows(std::span<const double> R, const Eigen::Vector3d& t) {
  if (R.size() != 9) return {};
  const Eigen::Matrix3d rotation =
      Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R.data());
  if (!rotation.allFinite() || !t.allFinite() || rotation.determinant() <= 0 ||
      (rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).norm() > 2e-2) {
    return {};
  }
  return Pose(rotation, t);
}

}  // namespace corvid
