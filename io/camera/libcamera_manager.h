#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "corvid/error.h"

namespace libcamera {
class Camera;
class CameraManager;
}  // namespace libcamera

namespace corvid {

/// The process's camera manager: libcamera allows only one. It runs, with a thread of its own that
/// follows what is plugged in and out, from the first holder to the last. Its log goes to
/// core/log.h at debug level, unless LIBCAMERA_LOG_FILE names another place.
/// Errors: io (it does not start).
[[nodiscard]] Expected<std::shared_ptr<libcamera::CameraManager>> hold_camera_manager();

/// The folders below /sys/dev/char of the video devices that the camera captures from. They
/// disappear with the device, before libcamera hears of it.
[[nodiscard]] std::vector<std::filesystem::path> device_folders(libcamera::CameraManager& manager,
                                                                const libcamera::Camera& camera);

/// Whether all of device_folders() are still there.
[[nodiscard]] bool is_plugged_in(const std::vector<std::filesystem::path>& folders);

}  // namespace corvid
