#include "io/camera/frame_count.h"

#include <fmt/format.h>

#include "core/messages.h"

namespace corvid {

std::uint64_t FrameCount::came(std::uint32_t number) {
  if (!any_) {
    any_ = true;
    sequence_ = number;
  } else {
    const std::uint32_t step = number - last_number_;
    const bool rises = step != 0 && step < std::uint32_t{1} << 31;
    sequence_ += rises ? step : 1;
    counts_.lost += rises ? step - 1 : 0;
  }
  last_number_ = number;
  return sequence_;
}

void FrameCount::damaged(std::uint64_t sequence, const std::string& why) {
  ++counts_.damaged;
  add_message(counts_.messages, fmt::format("picture {}: {}", sequence, why));
}

}  // namespace corvid
