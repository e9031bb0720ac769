#pragma once

#include <cstddef>
#include <filesystem>
#include <vector>

#include "corvid/error.h"
#include "corvid/map.h"

namespace corvid {

struct ColmapOptions {
  int jpeg_quality = 95;
  bool png = false;  ///< lossless images instead of JPEG
};

/// What one segment's model holds.
struct ColmapModel {
  int segment = 0;
  std::size_t images = 0, points = 0, observations = 0;
  double mean_error_px = 0;  ///< mean reprojection error over the observations
  std::filesystem::path sparse_dir;
};

/// Writes keyframes and landmarks as a COLMAP text model with undistorted images: `dir/images/`,
/// and beside it `dir/sparse/` with cameras.txt, images.txt, points3D.txt. What OpenMVS and the
/// splatting trainers take.
///
/// One PINHOLE camera is shared by all images. Poses are camera-from-world with the quaternion's w
/// first. COLMAP puts the top-left corner of the image at (0, 0), so its pixels are ours plus 0.5.
/// The tracks of points3D.txt and the observations of images.txt name each other; observations
/// that fall outside the undistorted image, and points left with fewer than two, are left out.
/// A map in several segments has no common frame: the one with the most keyframes goes to
/// `sparse/`, each other one to `sparse_segment_<n>/`.
/// @return the models, that of `sparse/` first.
/// Errors: invalid_argument if the map has no camera or no keyframe with an image; io.
[[nodiscard]] Expected<std::vector<ColmapModel>> write_colmap(const MapSnapshot& map,
                                                              const std::filesystem::path& dir,
                                                              const ColmapOptions& options = {});

}  // namespace corvid
