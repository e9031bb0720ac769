#include "io/source.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <exception>

#include "io/image_file.h"
#include "io/readers/readers.h"
#include "io/source_images.h"
#include "io/source_video.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

// The first that recognises a folder reads it: formats with unmistakable files come first.
constexpr std::array kReaders = {
    FolderReader{"EuRoC/ASL", "mav0/cam0/data.csv", recognises_asl, read_asl},
    FolderReader{"KITTI odometry", "calib.txt with image_0 or image_2", recognises_kitti,
                 read_kitti_odometry},
    FolderReader{"TUM RGB-D", "rgb.txt", recognises_tum_rgbd, read_tum_rgbd},
    FolderReader{"TUM monoVO", "camera.txt and times.txt with images/", recognises_mono_vo,
                 read_mono_vo},
    FolderReader{"COLMAP text model", "cameras.txt and images.txt, here or in sparse/",
                 recognises_colmap, read_colmap},
    FolderReader{"Middlebury multi-view", "*_par.txt", recognises_middlebury, read_middlebury},
    FolderReader{"Strecha multi-view", "*.camera", recognises_strecha, read_strecha},
    FolderReader{"7-Scenes", "frame-*.color.*", recognises_seven_scenes, read_seven_scenes},
    FolderReader{"image folder", "jpg, png, bmp, tif, pgm images here or in images/",
                 recognises_image_folder, read_image_folder},
};

// What lies in a folder that is nothing, so that the user sees where the path leads.
std::string contents(const fs::path& folder) {
  std::vector<std::string> names = folder_names(folder);
  for (std::string& name : names) name += "/";
  const std::vector<std::string> files = file_names(folder);
  names.insert(names.end(), files.begin(), files.end());
  if (names.empty()) return "the folder is empty";
  const std::size_t shown = std::min<std::size_t>(names.size(), 5);
  std::string text = "the folder has ";
  for (std::size_t i = 0; i < shown; ++i) text += (i ? ", " : "") + names[i];
  return names.size() > shown ? fmt::format("{} and {} more", text, names.size() - shown) : text;
}

Expected<std::unique_ptr<FrameSource>> open_file(const std::string& path,
                                                 const SourceOptions& options) {
  if (is_video_name(path)) return open_video(path, options);
  const std::string parent = fs::absolute(path).parent_path().string();
  if (is_image_name(fs::path(path).filename().string())) {
    return fail(ErrorCode::unsupported, "this is a single image", path,
                "give its folder: " + parent);
  }
  return fail(ErrorCode::unsupported, "this file is no video that can be read", path,
              "give a video file or the folder of a data set");
}

Expected<std::unique_ptr<FrameSource>> open_folder(const std::string& path,
                                                   const SourceOptions& options) {
  const fs::path folder(path);
  std::error_code error;
  const fs::directory_iterator readable(folder, error);
  if (error) return fail(ErrorCode::io, "the folder cannot be read: " + error.message(), path);
  std::string looked_for;
  for (const FolderReader& reader : folder_readers()) {
    if (reader.recognises(folder)) {
      Expected<ImageList> list = reader.read(folder);
      if (!list) return tl::unexpected(list.error());
      return open_image_list(path, std::move(*list), options);
    }
    looked_for +=
        fmt::format("{}{} ({})", looked_for.empty() ? "" : "; ", reader.looks_for, reader.kind);
  }
  return fail(ErrorCode::unsupported, "no images were found; " + contents(folder), path,
              "looked for: " + looked_for);
}

}  // namespace

std::span<const FolderReader> folder_readers() { return kReaders; }

Expected<std::unique_ptr<FrameSource>> open_source(const std::string& path,
                                                   const SourceOptions& options) {
  if (auto ok = check_source_options(options); !ok) return tl::unexpected(ok.error());
  try {
    std::error_code error;
    const fs::file_status status = fs::status(path, error);
    if (status.type() == fs::file_type::not_found) {
      return fail(ErrorCode::not_found, "there is no such file or folder", path);
    }
    if (fs::is_directory(status)) return open_folder(path, options);
    if (fs::is_regular_file(status)) return open_file(path, options);
    return fail(ErrorCode::io,
                error ? "it cannot be read: " + error.message() : "this is no file and no folder",
                path);
  } catch (const fs::filesystem_error& e) {  // a path that vanishes or cannot be made absolute
    return fail(ErrorCode::io, e.code().message(), path);
  }
}

}  // namespace corvid
