#pragma once

#include <cstdint>
#include <string>

#include "core/clock.h"
#include "corvid/ports.h"

namespace corvid {

/// Tells systemd how a live run goes, by the protocol of sd_notify(3): ready with the first frame
/// that went through the tracking loop, then its watchdog, fed by that loop and by nothing else,
/// and a status line. Does nothing where no service manager listens. Frames come, blind ones at
/// least, as long as source, frontend and backend live: a camera that is away ends no service.
///
/// Never waits: libsystemd's sd_notify() stands still when the manager does not read, and the
/// tracking loop with it. What found no room is sent with a later frame.
class ServiceNotifier final : public PoseSink {
 public:
  explicit ServiceNotifier(Clock& clock);
  ~ServiceNotifier() override;
  ServiceNotifier(const ServiceNotifier&) = delete;
  ServiceNotifier& operator=(const ServiceNotifier&) = delete;
  void on_pose(const PoseEvent& event) override;
  /// A signal ends the run: what there is will be saved. No frames may come any more, and the last
  /// adjustment may take long, so the watchdog waits for an hour. From any thread.
  void stopping();
  /// The source has ended, which the watchdog takes in the same way. From any thread.
  void finishing();

 private:
  bool send(const std::string& message) const;

  Clock& clock_;
  int fd_ = -1;
  std::int64_t watchdog_ns_ = 0;  ///< a quarter of what is demanded between two signs; 0: none
  std::int64_t fed_ns_ = 0, told_ns_ = 0;
  std::uint64_t frames_ = 0;
  bool ready_ = false;
};

}  // namespace corvid
