#pragma once

#include <cstdint>
#include <string>

#include "core/clock.h"
#include "corvid/ports.h"

namespace corvid {

/// Tells systemd how a live run goes (sd_notify(3)): ready with the first frame that went through
/// the tracking loop, then its watchdog, fed by that loop and by nothing else, and a status line.
/// Does nothing where no service manager listens. Frames come, blind ones at least, as long as
/// source, frontend and backend live, so a camera that is away does not end the service.
class ServiceNotifier final : public PoseSink {
 public:
  explicit ServiceNotifier(Clock& clock);
  void on_pose(const PoseEvent& event) override;
  /// The run is ending: what there is will be saved.
  void stopping();

 private:
  Clock& clock_;
  std::int64_t watchdog_ns_ =
      0;  ///< between two signs of life, a quarter of what is demanded; 0: none
  std::int64_t fed_ns_ = 0, told_ns_ = 0;
  std::uint64_t frames_ = 0;
  bool ready_ = false;
};

}  // namespace corvid
