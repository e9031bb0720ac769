#include "engine/in_order.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "core/clock.h"
#include "core/messages.h"

namespace corvid {
namespace {

constexpr double kLeap_s = 10;
constexpr std::size_t kMostLate = 10;
constexpr std::string_view kTwice = "that of the frame before it";

}  // namespace

Expected<FramePtr> InOrder::take(const std::stop_token& stop) {
  if (!taken_) return source_.next(stop);
  auto frame = std::move(*taken_);
  taken_.reset();
  return frame;
}

FramePtr InOrder::accept(FramePtr frame) {
  newest_ns_ = frame->time_ns;
  last_late_ns_.reset();
  late_in_a_row_ = 0;
  return frame;
}

void InOrder::refuse(const Frame& frame, std::string_view why) {
  if (!frame.blind.empty()) return;
  ++refused_.skipped;
  add_message(refused_.messages, fmt::format("frame {}: its time is {}", frame.id.value, why));
}

Expected<FramePtr> InOrder::next(const std::stop_token& stop) {
  while (true) {
    auto frame = take(stop);
    const bool over = !frame || !*frame;
    if (leapt_ && (over || (*frame)->time_ns > leapt_->time_ns)) {
      taken_ = std::move(frame);
      return accept(std::exchange(leapt_, nullptr));
    }
    if (over) return frame;
    const std::int64_t time_ns = (*frame)->time_ns;
    if (!newest_ns_) return accept(std::move(*frame));
    if (leapt_ && time_ns == leapt_->time_ns) {
      refuse(**frame, kTwice);
      continue;
    }
    const double step_s = difference_s(time_ns, *newest_ns_);
    if (time_ns > *newest_ns_) {
      if (leapt_) refuse(*leapt_, "far ahead of that of the frame after it");
      leapt_.reset();
      if (step_s <= kLeap_s) return accept(std::move(*frame));
      leapt_ = std::move(*frame);
      continue;
    }
    refuse(**frame, time_ns == *newest_ns_ ? kTwice : "before that of the frame before it");
    const bool late = step_s < -kLeap_s;
    const bool rises = last_late_ns_ && time_ns > *last_late_ns_;
    late_in_a_row_ = !late ? 0 : rises ? late_in_a_row_ + 1 : 1;
    last_late_ns_ = late ? std::optional(time_ns) : std::nullopt;
    if (late_in_a_row_ == kMostLate)
      return fail(ErrorCode::corrupt,
                  fmt::format("the clock of the frames went back by {:.3f} s for good", -step_s),
                  fmt::format("frame {}", (*frame)->id.value),
                  "begin a new run; check the camera's clock, or the times in the recording");
  }
}

SourceCounts InOrder::counts() const {
  SourceCounts counts = source_.counts();
  counts.skipped += refused_.skipped;
  counts.delivered -= std::min(counts.delivered, refused_.skipped);
  for (const std::string& message : refused_.messages) add_message(counts.messages, message);
  return counts;
}

}  // namespace corvid
