#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "core/clock.h"
#include "corvid/ports.h"
#include "io/descriptor.h"
#include "io/mavlink/line.h"
#include "io/mavlink/mavlink_options.h"

namespace corvid {

/// What a link did, for reports.
struct MavlinkStatistics {
  std::uint64_t sent = 0;      ///< packets
  std::uint64_t dropped = 0;   ///< packets for which the line had no room, or that nobody took
  std::uint64_t replaced = 0;  ///< pose events that a newer one overtook before the link's turn
  std::uint64_t reconnections = 0;  ///< the line was opened anew
  std::uint64_t failures = 0;       ///< the line broke, or could not be opened anew
  std::string last_failure;         ///< with its place; empty if there was none
  OdometryCounts odometry;
  MavlinkReceived received;
  mavlink::ParserCounts parser;
  std::optional<double> autopilot_clock_ahead_s;  ///< once it has answered
};

/// A MAVLink link to an autopilot: poses go out as ODOMETRY, its satellite positions come in.
///
/// Has one thread, which waits for the line and the next thing that is due; a line that is slow,
/// full or gone holds up nobody. A line that breaks is opened again, after 0.25 s and then more and
/// more rarely, down to every 5 s, until bytes go through it.
class MavlinkLink final : public PoseSink {
 public:
  /// Opens the line. Errors: those of MavlinkLine::open().
  /// @param clock      that of the events' times (CLOCK_MONOTONIC for a live camera); asked from
  ///                   two threads. Must outlive the link.
  /// @param positions  where the autopilot's positions go; may be null. Must outlive the link.
  [[nodiscard]] static Expected<std::unique_ptr<MavlinkLink>> open(const MavlinkOptions& options,
                                                                   Clock& clock,
                                                                   PositionFeed* positions);
  ~MavlinkLink() override;

  /// Returns at once; of events that come faster than the link takes them the newest counts.
  void on_pose(const PoseEvent& event) override;
  [[nodiscard]] MavlinkStatistics statistics() const;
  /// The UDP port that it has here; 0 for a serial line.
  [[nodiscard]] int local_port() const { return local_port_; }

 private:
  MavlinkLink(std::unique_ptr<MavlinkLine> line, const MavlinkOptions& options, Clock& clock,
              PositionFeed* positions);
  void run(const std::stop_token& stop);
  void wait();
  void read();
  void take_event();
  void write();
  void reopen(std::int64_t now_ns);
  void broke(const Error& error);
  void works();
  void publish();
  void wake() const;

  struct Waiting {
    PoseEvent event;
    std::int64_t arrival_ns = 0;
  };

  std::unique_ptr<MavlinkLine> line_;
  Clock& clock_;
  Descriptor wake_;
  int local_port_ = 0;

  // The link's thread only.
  MavlinkNode node_;
  std::deque<MavlinkOutgoing> kept_;  // lasting packets for which there was no room, one of a kind
  MavlinkStatistics now_;
  std::int64_t retry_ns_ = 0;  // when a broken line is opened again
  std::int64_t pause_ns_ = 0;  // before the next such attempt; 0: bytes went through

  mutable std::mutex mutex_;
  std::optional<Waiting> newest_;
  std::uint64_t replaced_ = 0;
  MavlinkStatistics published_;

  std::jthread thread_;
};

}  // namespace corvid
