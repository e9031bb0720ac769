#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "replay/random.h"
#include "replay/synthetic_flight.h"

namespace corvid::scenes {

/// What goes wrong on a flight. Frames are counted as the flight has them; the default is nothing.
struct Disturbance {
  using Span = std::pair<std::size_t, std::size_t>;  ///< frames [first, second)

  Span away{};                               ///< the camera is unplugged: blind frames
  Span covered{};                            ///< a hand before the lens: dark, noise only
  double missing = 0;                        ///< share of the frames that never come
  std::optional<std::size_t> twice_every;    ///< each n-th frame comes twice
  std::optional<std::size_t> stale_every;    ///< each n-th frame shows the picture before it
  Span frozen{};                             ///< show the picture before the first of them
  std::optional<std::size_t> swapped_every;  ///< each n-th frame comes after the next one
  std::optional<std::size_t> brighter_from;  ///< exposure jumps here
  double brighter = 1;                       ///< by this factor; bright parts saturate
  std::optional<std::size_t> kidnapped_at;   ///< from here on the camera is elsewhere,
  std::size_t kidnapped_by = 0;              ///< so many frames ahead on its path
  std::optional<std::size_t> patch_from;     ///< a third of the image moves on its own from here on
  double focal = 1;                          ///< factor on the focal length that is told
  std::uint64_t seed = 1;                    ///< of what is missing and of the patch
  /// Instead of the flight's own pose, by the number of the frame.
  std::function<Pose(const SyntheticFlight&, std::size_t)> pose;
};

/// A synthetic flight with a disturbance, and the truth of what its frames show.
class DisturbedFlight final : public FrameSource {
 public:
  /// @param frames  how many frames long the flight is before anything is taken from it.
  DisturbedFlight(FlightOptions options, std::size_t frames, Disturbance disturbance)
      : disturbance_(std::move(disturbance)), flight_(lengthened(options, frames, disturbance_)) {
    info_ = flight_.info();
    if (disturbance_.focal != 1) {
      auto camera = std::make_shared<Camera>(flight_.camera());
      camera->fx_px *= disturbance_.focal;
      camera->fy_px *= disturbance_.focal;
      info_.camera = camera;
    }
    if (disturbance_.patch_from) patch_ = flight_.render(0)->grey;
    Random coin(disturbance_.seed);
    for (std::size_t i = 0; i < frames; ++i) {
      if (coin.uniform() < disturbance_.missing) continue;
      order_.push_back(i);
      if (every(disturbance_.twice_every, i)) order_.push_back(i);
    }
    for (std::size_t k = 0; k + 1 < order_.size(); ++k)
      if (every(disturbance_.swapped_every, order_[k])) {
        std::swap(order_[k], order_[k + 1]);
        ++k;
      }
    for (std::size_t i = 0; i < frames; ++i) truth_.push_back({flight_.time_ns(i), true_pose(i)});
  }

  [[nodiscard]] const SourceInfo& info() const override { return info_; }
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& = {}) override {
    if (given_ >= order_.size()) return FramePtr{};
    return picture(order_[given_++]);
  }
  [[nodiscard]] SourceCounts counts() const override { return {given_, 0, 0, {}}; }
  [[nodiscard]] Trajectory truth() const override { return truth_; }
  /// How many frames are handed out altogether.
  [[nodiscard]] std::size_t frames() const { return order_.size(); }

 private:
  static FlightOptions lengthened(FlightOptions options, std::size_t frames,
                                  const Disturbance& disturbance) {
    options.duration_s = static_cast<double>(frames + disturbance.kidnapped_by) / options.rate_hz;
    return options;
  }
  static bool every(const std::optional<std::size_t>& n, std::size_t i) {
    return n && i % *n == *n - 1;
  }
  /// The pose that the camera has in frame i.
  [[nodiscard]] Pose true_pose(std::size_t i) const {
    if (disturbance_.kidnapped_at && i >= *disturbance_.kidnapped_at)
      i += disturbance_.kidnapped_by;
    return disturbance_.pose ? disturbance_.pose(flight_, i) : flight_.true_pose(i);
  }

  [[nodiscard]] FramePtr picture(std::size_t i) const {
    std::size_t shown = i > 0 && every(disturbance_.stale_every, i) ? i - 1 : i;
    if (i >= disturbance_.frozen.first && i < disturbance_.frozen.second)
      shown = disturbance_.frozen.first - 1;
    auto frame = std::make_shared<Frame>();
    const auto [from, to] = disturbance_.covered;
    if (i >= disturbance_.away.first && i < disturbance_.away.second) {
      frame->blind = "the camera is unplugged";
    } else if (i >= from && i < to) {
      frame->grey = GreyImage(info_.camera->width_px, info_.camera->height_px);
      Random noise(mix64(disturbance_.seed) + i);
      for (std::size_t p = 0; p < frame->grey.size(); ++p)
        frame->grey.data()[p] = static_cast<std::uint8_t>(2 + noise.below(4));
    } else {
      *frame = *flight_.render(true_pose(shown), shown);
    }
    frame->id = FrameId(static_cast<std::uint32_t>(i));
    frame->time_ns = flight_.time_ns(i);
    frame->camera = info_.camera;
    if (disturbance_.brighter_from && i >= *disturbance_.brighter_from)
      for (std::size_t p = 0; p < frame->grey.size(); ++p)
        frame->grey.data()[p] = static_cast<std::uint8_t>(
            std::min(255.0, std::round(disturbance_.brighter * frame->grey.data()[p])));
    if (disturbance_.patch_from && i >= *disturbance_.patch_from) paste_patch(i, frame->grey);
    return frame;
  }

  /// A piece of another picture, two thirds of the width times half of the height, that swings
  /// through the image as one thing.
  void paste_patch(std::size_t i, GreyImage& image) const {
    const int width = image.width() * 2 / 3, height = image.height() / 2;
    const double t = static_cast<double>(i);
    const int left = static_cast<int>((image.width() - width) * (0.5 + 0.5 * std::sin(0.15 * t)));
    const int top = static_cast<int>((image.height() - height) * (0.5 + 0.5 * std::sin(0.09 * t)));
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) image(left + x, top + y) = patch_(x, y + height);
  }

  Disturbance disturbance_;
  SyntheticFlight flight_;
  SourceInfo info_;
  std::vector<std::size_t> order_;
  GreyImage patch_;
  Trajectory truth_;
  std::size_t given_ = 0;
};

}  // namespace corvid::scenes
