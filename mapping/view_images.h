#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>

#include "corvid/map.h"
#include "kernels/depth.h"
#include "kernels/warp.h"

namespace corvid {

/// The keyframes' images as depth needs them: undistorted, reduced to one ray per scale x scale
/// pixels. Those on the device are kept for the next keyframe, up to a budget.
class ViewImages {
 public:
  /// @param scale  0: the least that keeps a map within 640 x 480 rays.
  /// @param budget_bytes  device memory for kept images; at least the one just asked for is kept.
  ViewImages(std::shared_ptr<Device> device, Warper warper, int scale, std::size_t budget_bytes);

  /// The camera that all images below have, for a lens as given.
  [[nodiscard]] Camera camera_of(const Camera& lens) const;

  /// For the sweep; nothing if the frame has another size than the lens. Valid while the caller
  /// holds it. Throws DeviceFault.
  [[nodiscard]] std::shared_ptr<const SweepImage> sweep_image(const Keyframe& keyframe,
                                                              const Camera& lens,
                                                              DepthSweeper& sweeper);
  /// The frame's colours (grey if it has none) seen by camera_of(lens); a function of its arguments
  /// only.
  [[nodiscard]] ColourImage colours(const Frame& frame, const Camera& lens);

 private:
  struct Kept {
    std::shared_ptr<const SweepImage> image;
    std::uint64_t last_use = 0;
  };
  void prepare_for(const Camera& lens);
  [[nodiscard]] int scale_for(const Camera& lens) const;

  std::shared_ptr<Device> device_;
  Warper warper_;
  int asked_scale_;
  std::size_t budget_bytes_;
  std::optional<Camera> lens_;              ///< that everything below was made for
  std::optional<DeviceWarpMap> undistort_;  ///< full size; nothing for a plain pinhole
  std::optional<WarpMap> reduce_;           ///< from the frame to camera_of(lens)
  std::map<KeyframeId, Kept> kept_;
  std::uint64_t uses_ = 0;
};

}  // namespace corvid
