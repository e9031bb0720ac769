#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "corvid/error.h"
#include "io/camera/camera_stream.h"

namespace libcamera {
class Camera;
class CameraConfiguration;
class ControlList;
}  // namespace libcamera

namespace corvid {

/// The roles in which a camera may stream, the most fitting that it has. Nothing if it has none.
[[nodiscard]] std::unique_ptr<libcamera::CameraConfiguration> generate_configuration(
    libcamera::Camera& camera);

/// Format and size as the camera was set to.
struct LibcameraSetup {
  std::unique_ptr<libcamera::CameraConfiguration> configuration;  ///< of one stream
  std::uint32_t fourcc = 0;                                       ///< V4L2's
  std::size_t stride_bytes = 0;
  StreamSettings settings;
};

/// Sets an acquired camera to what is asked for; what it changes is noted.
/// Errors: invalid_argument, unsupported, io (refused).
[[nodiscard]] Expected<LibcameraSetup> set_up_camera(libcamera::Camera& camera,
                                                     const CameraRequest& request);

/// The controls of exposure, gain and rate, as far as the camera has them, within its limits; what
/// it lacks or limits is noted, and the rate is set in `settings`. `then` must follow `first` with
/// a later request: some cameras refuse an exposure while theirs is automatic.
void plan_controls(const libcamera::Camera& camera, const CameraRequest& request,
                   libcamera::ControlList& first, libcamera::ControlList& then,
                   StreamSettings& settings);

}  // namespace corvid
