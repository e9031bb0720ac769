#include "backend/backend_impl.h"

#include <algorithm>
#include <array>

#include "core/median.h"

namespace corvid {
namespace {

constexpr int kIntrinsicsFrom = 6;    ///< keyframes before intrinsics are refined
constexpr int kIntrinsicsUntil = 30;  ///< keyframes after which windows leave them alone
/// Keyframes at which the distortion alone is refined.
constexpr std::array kDistortionAt{6, 9, 13, 20, 30};

}  // namespace

/// For the adjustment after a new keyframe, while the intrinsics settle.
IntrinsicsPolicy Backend::Impl::intrinsics_policy() const {
  IntrinsicsPolicy policy;
  policy.prior = prior;
  const int n = segment_keyframes();
  if (freedom == IntrinsicsFreedom::fixed || n < kIntrinsicsFrom || n > kIntrinsicsUntil)
    return policy;
  if (freedom == IntrinsicsFreedom::radial) {
    // adjust_window() itself refuses what is not beyond doubt; a few attempts are enough.
    if (std::find(kDistortionAt.begin(), kDistortionAt.end(), n) != kDistortionAt.end())
      policy.freedom = freedom;
    return policy;
  }
  std::vector<double> angles;
  for (const TrackId id : map.keyframes.back().tracks) {
    const auto it = map.tracks.find(id);
    if (it != map.tracks.end() && it->second.landmark) {
      angles.push_back(it->second.max_ray_angle_rad);
    }
  }
  if (wide_enough(std::move(angles))) policy.freedom = IntrinsicsFreedom::focal;
  return policy;
}

/// Whether the windows reach over the whole segment, because everything moves with the intrinsics.
bool Backend::Impl::intrinsics_settle() const {
  return freedom == IntrinsicsFreedom::all && segment_keyframes() <= kIntrinsicsUntil;
}

/// Over the whole map, for the last adjustment.
IntrinsicsPolicy Backend::Impl::final_intrinsics_policy() const {
  IntrinsicsPolicy policy;
  policy.prior = prior;
  if (map.keyframes.size() < static_cast<std::size_t>(kIntrinsicsFrom)) return policy;
  std::vector<double> angles;
  for (const auto& [id, track] : map.tracks) {
    if (track.landmark) angles.push_back(track.max_ray_angle_rad);
  }
  if (freedom == IntrinsicsFreedom::radial || wide_enough(std::move(angles)))
    policy.freedom = freedom;
  return policy;
}

/// Intrinsics and a flat fan of rays cannot be told apart.
bool Backend::Impl::wide_enough(std::vector<double> ray_angles_rad) const {
  return upper_median(std::move(ray_angles_rad)) > 2 * options.start_min_parallax_rad;
}

void Backend::Impl::learn_focal() {
  // The estimates were made with another camera.
  if (freedom == IntrinsicsFreedom::all || map.camera.distortion != focal_camera.distortion)
    focal.clear();
  focal_camera = map.camera;
  focal.add(map.keyframes.back().focal, std::min(options.window_keyframes, segment_keyframes()));
}

}  // namespace corvid
