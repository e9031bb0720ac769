#pragma once

#include <memory>
#include <vector>

#include "core/clock.h"
#include "corvid/error.h"
#include "io/camera/camera_stream.h"

namespace corvid {

/// The cameras that libcamera knows, sorted by id, those that stream now among them. Empty if there
/// are none or libcamera cannot be started; the log says which.
[[nodiscard]] std::vector<CameraListing> list_libcamera_cameras();

/// Starts a camera by libcamera's requests.
/// @param request  device: libcamera's id, as it stands after "libcamera:" in the listing; format:
///                 libcamera's name ("R8", "YUYV").
/// @param clock    gives the times of arrival; asked on libcamera's thread and must outlive the
///                 stream.
/// Capture times are the sensor's where they belong to CLOCK_MONOTONIC or CLOCK_BOOTTIME
/// (SensorClock), else those of arrival, and then a note of the settings says so.
/// Errors: invalid_argument (a request that cannot be), not_found (no such camera), unsupported (no
/// such format), io (in use, refused by the driver).
[[nodiscard]] Expected<std::unique_ptr<CameraStream>> open_libcamera(const CameraRequest& request,
                                                                     Clock& clock);

}  // namespace corvid
