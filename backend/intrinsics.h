#pragma once

#include <string_view>

#include "corvid/camera.h"
#include "corvid/ports.h"

namespace corvid {

/// Which intrinsics an adjustment may change, as far as the camera model has them.
enum class IntrinsicsFreedom {
  fixed,
  radial,  ///< k1, k2
  focal,   ///< focal length, k1, k2
  all      ///< focal length, principal point, all of the distortion
};

/// What `backend.intrinsics` means for a camera: "fixed" and "all" as they say, "distortion":
/// radial; "auto": all where no calibration is known, and radial for a calibrated camera that
/// claims to have no distortion: images that were rectified keep some, and it bends the whole
/// trajectory (docs/decisions/residual-distortion.md).
[[nodiscard]] IntrinsicsFreedom intrinsics_freedom(std::string_view option, IntrinsicsOrigin origin,
                                                   const Camera& camera);

/// The same camera in a model with room for the freedom: a pinhole becomes radtan without
/// distortion, unless everything is fixed.
[[nodiscard]] Camera adjustable(Camera camera, IntrinsicsFreedom freedom);

}  // namespace corvid
