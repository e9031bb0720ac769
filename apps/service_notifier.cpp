#include "apps/service_notifier.h"

#include <fmt/format.h>
#include <systemd/sd-daemon.h>

namespace corvid {
namespace {
constexpr std::int64_t kStatusInterval_ns = 2'000'000'000;
}

ServiceNotifier::ServiceNotifier(Clock& clock) : clock_(clock) {
  std::uint64_t demanded_us = 0;
  if (sd_watchdog_enabled(0, &demanded_us) > 0)
    watchdog_ns_ = static_cast<std::int64_t>(demanded_us) * 1000 / 4;
}

void ServiceNotifier::on_pose(const PoseEvent& event) {
  ++frames_;
  const std::int64_t now_ns = clock_.now_ns();
  if (!ready_) {
    sd_notify(0, "READY=1");
    ready_ = true;
  }
  if (watchdog_ns_ > 0 && (fed_ns_ == 0 || now_ns - fed_ns_ >= watchdog_ns_)) {
    sd_notify(0, "WATCHDOG=1");
    fed_ns_ = now_ns;
  }
  if (told_ns_ == 0 || now_ns - told_ns_ >= kStatusInterval_ns) {
    sd_notify(0, fmt::format("STATUS={}{}{}, frame {}, segment {}, scale {}",
                             to_string(event.state), event.reason.empty() ? "" : ": ", event.reason,
                             frames_, event.segment, to_string(event.scale))
                     .c_str());
    told_ns_ = now_ns;
  }
}

void ServiceNotifier::stopping() { sd_notify(0, "STOPPING=1\nSTATUS=saving"); }

}  // namespace corvid
