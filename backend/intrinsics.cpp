#include "backend/intrinsics.h"

#include <algorithm>

namespace corvid {

IntrinsicsFreedom intrinsics_freedom(std::string_view option, IntrinsicsOrigin origin,
                                     const Camera& camera) {
  if (option == "fixed") return IntrinsicsFreedom::fixed;
  if (option == "distortion") return IntrinsicsFreedom::radial;
  if (option == "all" || origin != IntrinsicsOrigin::calibration) return IntrinsicsFreedom::all;
  const bool undistorted = camera.model == CameraModel::pinhole ||
                           (camera.model == CameraModel::radtan &&
                            std::all_of(camera.distortion.begin(), camera.distortion.end(),
                                        [](double k) { return k == 0; }));
  return undistorted ? IntrinsicsFreedom::radial : IntrinsicsFreedom::fixed;
}

Camera adjustable(Camera camera, IntrinsicsFreedom freedom) {
  if (freedom != IntrinsicsFreedom::fixed && camera.model == CameraModel::pinhole)
    camera.model = CameraModel::radtan;
  return camera;
}

}  // namespace corvid
