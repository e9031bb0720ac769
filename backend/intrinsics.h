#pragma once

#include <string_view>

#include "corvid/camera.h"
#include "corvid/ports.h"

namespace corvid {

/// Which intrinsics an adjustment may change; k1 and k2 where the camera model has them.
enum class IntrinsicsFreedom { fixed, distortion, all };

/// What `backend.intrinsics` means for a camera: "fixed", "distortion" and "all" as they say;
/// "auto": all where no calibration is known, and the distortion of a calibrated camera that claims
/// to have none: images that were rectified keep some, and it bends the whole trajectory
/// (docs/decisions/residual-distortion.md).
[[nodiscard]] IntrinsicsFreedom intrinsics_freedom(std::string_view option, IntrinsicsOrigin origin,
                                                   const Camera& camera);

/// The same camera in a model with room for the freedom: a pinhole becomes radtan without
/// distortion, unless everything is fixed.
[[nodiscard]] Camera adjustable(Camera camera, IntrinsicsFreedom freedom);

}  // namespace corvid
