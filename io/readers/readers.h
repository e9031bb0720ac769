#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "corvid/error.h"
#include "io/readers/image_list.h"

namespace corvid {

/// One format of image folders.
struct FolderReader {
  std::string_view kind;
  std::string_view looks_for;  ///< for the message that nothing was found
  bool (*recognises)(const std::filesystem::path& folder);
  Expected<ImageList> (*read)(const std::filesystem::path& folder);
};

/// All formats; the first that recognises a folder reads it.
[[nodiscard]] std::span<const FolderReader> folder_readers();

bool recognises_asl(const std::filesystem::path& folder);
Expected<ImageList> read_asl(const std::filesystem::path& folder);
bool recognises_kitti(const std::filesystem::path& folder);
Expected<ImageList> read_kitti_odometry(const std::filesystem::path& folder);
bool recognises_tum_rgbd(const std::filesystem::path& folder);
Expected<ImageList> read_tum_rgbd(const std::filesystem::path& folder);
bool recognises_mono_vo(const std::filesystem::path& folder);
Expected<ImageList> read_mono_vo(const std::filesystem::path& folder);
bool recognises_seven_scenes(const std::filesystem::path& folder);
Expected<ImageList> read_seven_scenes(const std::filesystem::path& folder);
/// Where its frames lie: the folder itself, its data/, or its only seq-NN.
/// @pre recognises_seven_scenes(folder).
[[nodiscard]] std::filesystem::path seven_scenes_frames(const std::filesystem::path& folder);
bool recognises_colmap(const std::filesystem::path& folder);
Expected<ImageList> read_colmap(const std::filesystem::path& folder);
bool recognises_middlebury(const std::filesystem::path& folder);
Expected<ImageList> read_middlebury(const std::filesystem::path& folder);
bool recognises_strecha(const std::filesystem::path& folder);
Expected<ImageList> read_strecha(const std::filesystem::path& folder);
bool recognises_image_folder(const std::filesystem::path& folder);
Expected<ImageList> read_image_folder(const std::filesystem::path& folder);

// What several readers need.

[[nodiscard]] bool is_file(const std::filesystem::path& path);
[[nodiscard]] bool is_folder(const std::filesystem::path& path);
/// Names of the files of a folder in natural order; empty if the folder cannot be read.
[[nodiscard]] std::vector<std::string> file_names(const std::filesystem::path& folder);
/// Names of the folders in a folder, in natural order.
[[nodiscard]] std::vector<std::string> folder_names(const std::filesystem::path& folder);
/// Those of file_names() that are images.
[[nodiscard]] std::vector<std::string> image_names(const std::filesystem::path& folder);
/// The sub-folder that holds the images under one of the usual names, or the folder itself; empty
/// if neither has images.
[[nodiscard]] std::filesystem::path find_images_folder(const std::filesystem::path& folder);
/// True for the usual names of a folder of images: images, image, data, ...
[[nodiscard]] bool is_images_folder_name(const std::string& name);

/// Reads the calibration that lies in one of the folders under a usual name (the first found), into
/// `list`. Nothing found is no error.
[[nodiscard]] Expected<void> find_calibration(std::span<const std::filesystem::path> folders,
                                              ImageList& list);
/// Reads a truth file into list.truth; a broken one becomes a note, because a run can go without.
void add_truth(const std::filesystem::path& file, ImageList& list);

/// Names that count up, as `prefix` digits `suffix`: fills the gaps with the names of the missing
/// images, so that each is reported. Unchanged if the names are not of that kind.
struct NumberedName {
  std::int64_t number = 0;
  std::string name;
};
[[nodiscard]] std::vector<NumberedName> fill_gaps(const std::vector<std::string>& names);

/// True if the first JPEG of the list was taken by a photo camera.
[[nodiscard]] bool are_photographs(const std::vector<ImageEntry>& entries);
/// Times of images that have none: 1 s apart for photographs, else at `rate_hz`; says so in a note.
void set_times_by_index(ImageList& list, double rate_hz);

/// A pose from a rotation matrix row by row and a translation; nothing if it is no rotation.
[[nodiscard]] std::optional<Pose> pose_from_rows(std::span<const double> R,
                                                 const Eigen::Vector3d& t);

}  // namespace corvid
