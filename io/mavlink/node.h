#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "corvid/map.h"
#include "corvid/position.h"
#include "io/mavlink/clock_offset.h"
#include "io/mavlink/odometry_stream.h"
#include "io/mavlink/packet.h"

namespace corvid {

struct MavlinkNodeOptions {
  mavlink::Station station;
  OdometryOptions odometry;
  double gps_delay_s = 0.11;  ///< from a position to its GPS_RAW_INT in the autopilot
};

/// What came in, by kind.
struct MavlinkReceived {
  std::uint64_t heartbeats = 0, timesyncs = 0, gps = 0, others = 0;
  std::uint64_t positions = 0;  ///< of the GPS messages, handed to the feed
  std::uint64_t foreign = 0;    ///< GPS messages of other vehicles
};

/// A packet on its way out.
struct MavlinkOutgoing {
  std::uint32_t id = 0;
  std::vector<std::uint8_t> bytes;
  /// Worth sending later, too: not a measurement, not a time.
  [[nodiscard]] bool lasting() const {
    return id == mavlink::Heartbeat::kId || id == mavlink::StatusText::kId;
  }
};

/// One MAVLink component: what it says when, and what it makes of what it hears. Has no thread, no
/// line and no clock: what happens is told to it with the time. One owner.
class MavlinkNode {
 public:
  /// @param positions  where fixes go; may be null. Must outlive this.
  MavlinkNode(const MavlinkNodeOptions& options, PositionFeed* positions);

  /// @param arrival_ns  when the event came; its own time is the frame's. Both of one clock.
  void on_pose(const PoseEvent& event, std::int64_t arrival_ns);
  void on_bytes(std::span<const std::uint8_t> bytes, bool datagram, std::int64_t now_ns);
  /// The line was opened anew.
  void on_line_opened() { parser_.restart(); }
  /// What is due by now: heartbeat and a question for the time once a second, extrapolated poses,
  /// a word about a new state.
  void tick(std::int64_t now_ns);
  /// When tick() has something to do next; in the past if at once.
  [[nodiscard]] std::int64_t next_due_ns() const;
  /// What is to be sent, oldest first; then it is gone from here.
  [[nodiscard]] std::vector<MavlinkOutgoing> take_outgoing();

  [[nodiscard]] const MavlinkReceived& received() const { return received_; }
  [[nodiscard]] const mavlink::ParserCounts& parser() const { return parser_.counts(); }
  [[nodiscard]] const OdometryCounts& odometry() const { return odometry_.counts(); }
  [[nodiscard]] std::optional<std::int64_t> autopilot_offset_ns() const {
    return offset_.offset_ns();
  }
  /// Packets whose sender we take for a partner: any good one.
  [[nodiscard]] std::uint64_t good_packets() const {
    return parser_.counts().packets + parser_.counts().unknown;
  }

 private:
  enum class Condition { none, starting, without_scale, metric, lost, silent };

  template <class Message>
  void send(const Message& message);
  void receive(const mavlink::Packet& packet, std::int64_t now_ns);
  void receive(const mavlink::Timesync& timesync, mavlink::Station from, std::int64_t now_ns);
  void receive(const mavlink::GpsRawInt& gps, std::int64_t now_ns);
  [[nodiscard]] mavlink::SystemStatus status() const;
  [[nodiscard]] mavlink::StatusText words() const;

  MavlinkNodeOptions options_;
  PositionFeed* positions_;
  mavlink::PacketParser parser_;
  OdometryStream odometry_;
  ClockOffset offset_;
  MavlinkReceived received_;
  std::vector<MavlinkOutgoing> outgoing_;
  std::uint8_t sequence_ = 0;
  Condition condition_ = Condition::none, announced_ = Condition::none;
  std::string reason_;  // of the condition lost
  std::int64_t last_event_ns_ = INT64_MIN;
  std::int64_t next_beat_ns_ = INT64_MIN, next_words_ns_ = INT64_MIN;
  std::optional<std::int64_t> asked_ns_;  // our own question for the time
  std::uint64_t last_gps_usec_ = 0;
};

}  // namespace corvid
