#include "replay/player.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/check.h"

namespace corvid {

Player::Player(std::unique_ptr<FrameSource> source, Clock& clock, std::optional<double> rate)
    : SourceDecorator(std::move(source)), clock_(clock), rate_(rate) {
  CORVID_CHECK(!rate_ || (*rate_ > 0 && std::isfinite(*rate_)), "the rate must be positive");
  info_ = SourceDecorator::info();
  info_.paced = info_.paced || rate_.has_value();
}

Expected<FramePtr> Player::next(const std::stop_token& stop) {
  auto frame = SourceDecorator::next(stop);
  if (!rate_ || !frame || !*frame) return frame;
  const std::int64_t capture_ns = (*frame)->time_ns, now_ns = clock_.now_ns();
  if (!anchor_) anchor_ = Anchor{now_ns, capture_ns};
  // A year is further than any wait, and keeps the sum inside its type.
  constexpr double kYear_ns = 3.2e16;
  const double wait_ns = static_cast<double>(capture_ns - anchor_->capture_ns) / *rate_;
  const std::int64_t due_ns =
      anchor_->clock_ns + std::llround(std::clamp(wait_ns, -kYear_ns, kYear_ns));
  if (due_ns > now_ns) clock_.sleep_until(due_ns, stop);
  if (stop.stop_requested()) return FramePtr{};
  return frame;
}

}  // namespace corvid
