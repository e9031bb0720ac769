#pragma once

#include <memory>
#include <string>

#include "corvid/error.h"
#include "io/readers/image_list.h"
#include "io/source.h"

namespace corvid {

/// The options' own faults: a negative start, a step below 1, a rate that is no rate.
[[nodiscard]] Expected<void> check_source_options(const SourceOptions& options);

/// A camera for images without calibration: focal length from the EXIF of `path`, otherwise
/// 1.2 times the longer side; principal point in the middle. Fills camera, intrinsics and notes.
void assume_camera(const std::string& path, int width_px, int height_px, SourceInfo& info);

/// The camera of a calibration file, for pictures of this size; assume_camera() if `path` is empty.
/// Fills camera and notes. Errors: the file's, or that it does not fit the size.
[[nodiscard]] Expected<void> take_calibration(const std::string& path, int width_px, int height_px,
                                              SourceInfo& info);

/// The one source that delivers image files, whatever format listed them. Images that cannot be
/// read, have another size than the first, or whose time goes back are skipped and counted. Fails
/// if no image at all can be read or the calibration does not fit the images.
[[nodiscard]] Expected<std::unique_ptr<FrameSource>> open_image_list(const std::string& path,
                                                                     ImageList list,
                                                                     const SourceOptions& options);

/// Marks with true the fewest elements that must go for the rest to rise strictly; among equals the
/// later ones go. O(n log n).
[[nodiscard]] std::vector<bool> times_out_of_order(const std::vector<std::int64_t>& times_ns);

}  // namespace corvid
