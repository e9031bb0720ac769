#include "io/mavlink/clock_offset.h"

#include <algorithm>

namespace corvid {

void ClockOffset::add(std::int64_t asked_ns, std::int64_t theirs_ns, std::int64_t answered_ns) {
  const std::int64_t way_ns = answered_ns - asked_ns;
  if (way_ns < 0 || theirs_ns < 0) return;
  answers_.push_back({way_ns, theirs_ns - (asked_ns + way_ns / 2)});
  if (answers_.size() > kAnswers) answers_.pop_front();
}

std::optional<std::int64_t> ClockOffset::offset_ns() const {
  if (answers_.empty()) return std::nullopt;
  return std::min_element(answers_.begin(), answers_.end(),
                          [](const Answer& a, const Answer& b) { return a.way_ns < b.way_ns; })
      ->offset_ns;
}

}  // namespace corvid
