#include "engine/in_order.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>

namespace corvid {
namespace {

constexpr std::size_t kMostMessages = 100;

}  // namespace

Expected<FramePtr> InOrder::next(const std::stop_token& stop) {
  while (true) {
    auto frame = source_.next(stop);
    if (!frame || !*frame) return frame;
    const std::int64_t time_ns = (*frame)->time_ns;
    if (!newest_ns_ || time_ns > *newest_ns_) {
      newest_ns_ = time_ns;
      return frame;
    }
    ++refused_.skipped;
    if (refused_.messages.size() < kMostMessages)
      refused_.messages.push_back(
          fmt::format("frame {}: {}", (*frame)->id.value,
                      time_ns == *newest_ns_ ? "its time is that of the frame before it"
                                             : "its time is before that of the frame before it"));
  }
}

SourceCounts InOrder::counts() const {
  SourceCounts counts = source_.counts();
  counts.skipped += refused_.skipped;
  counts.delivered -= std::min(counts.delivered, refused_.skipped);
  for (const std::string& message : refused_.messages)
    if (counts.messages.size() < kMostMessages) counts.messages.push_back(message);
  return counts;
}

}  // namespace corvid
