#include "mapping/view_images.h"

#include <algorithm>
#include <utility>

namespace corvid {

ViewImages::ViewImages(std::shared_ptr<Device> device, Warper warper, int scale,
                       std::size_t budget_bytes)
    : device_(std::move(device)),
      warper_(std::move(warper)),
      asked_scale_(scale),
      budget_bytes_(budget_bytes) {}

int ViewImages::scale_for(const Camera& lens) const {
  constexpr std::int64_t kMostRays = 640L * 480;
  int scale = std::max(1, asked_scale_);
  const auto rays = [&] {
    return static_cast<std::int64_t>(lens.width_px / scale) * (lens.height_px / scale);
  };
  while (asked_scale_ == 0 && rays() > kMostRays) ++scale;
  return scale;
}

Camera ViewImages::camera_of(const Camera& lens) const {
  return DepthSweeper::scaled(lens.undistorted(), scale_for(lens));
}

void ViewImages::prepare_for(const Camera& lens) {
  if (lens_ == lens) return;
  kept_.clear();
  undistort_.reset();
  const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
  const Camera straight = lens.undistorted();
  if (!(straight == lens)) {
    undistort_ = warper_.upload(WarpMap::between(lens, straight, I), Lane::mapping);
  }
  reduce_ = WarpMap::between(lens, camera_of(lens), I);
  lens_ = lens;
}

std::shared_ptr<const SweepImage> ViewImages::sweep_image(const Keyframe& keyframe,
                                                          const Camera& lens,
                                                          DepthSweeper& sweeper) {
  prepare_for(lens);
  const StoredFrame& stored = *keyframe.frame;
  if (stored.width_px != lens.width_px || stored.height_px != lens.height_px) return nullptr;
  const FramePtr frame = kept_.contains(keyframe.id) ? nullptr : stored.load();
  if (frame && frame->grey.empty()) return nullptr;  // lost
  Kept& kept = kept_[keyframe.id];
  kept.last_use = ++uses_;
  if (frame) {
    DeviceImage image = upload(*device_, frame->grey, Lane::mapping);
    if (undistort_) image = warper_.remap(image, *undistort_, Lane::mapping);
    kept.image =
        std::make_shared<const SweepImage>(sweeper.prepare(image, scale_for(lens), Lane::mapping));
  }
  const auto result = kept.image;
  // Both levels, 4 bytes per pixel.
  const std::size_t bytes = 5 * static_cast<std::size_t>(result->full.width_px) *
                            static_cast<std::size_t>(result->full.height_px);
  while (kept_.size() > std::max<std::size_t>(1, budget_bytes_ / std::max<std::size_t>(1, bytes))) {
    kept_.erase(std::min_element(kept_.begin(), kept_.end(), [](const auto& a, const auto& b) {
      return a.second.last_use < b.second.last_use;
    }));
  }
  return result;
}

ColourImage ViewImages::colours(const Frame& frame, const Camera& lens) {
  prepare_for(lens);
  return remap_colours(frame, lens, *reduce_);
}

}  // namespace corvid
