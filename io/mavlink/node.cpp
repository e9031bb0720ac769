#include "io/mavlink/node.h"

#include <algorithm>
#include <utility>

#include "io/mavlink/gps_fix.h"

namespace corvid {
namespace {

using namespace mavlink;

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr std::int64_t kSilence_ns = kSecond_ns;  // without an event: the camera is away

/// a + b, for times that may be the least there is.
std::int64_t after(std::int64_t a_ns, std::int64_t b_ns) {
  return a_ns == INT64_MIN ? a_ns : a_ns + b_ns;
}

}  // namespace

MavlinkNode::MavlinkNode(const MavlinkNodeOptions& options, PositionFeed* positions)
    : options_(options), positions_(positions), odometry_(options.odometry) {}

template <class Message>
void MavlinkNode::send(const Message& message) {
  outgoing_.push_back({Message::kId, to_bytes(pack(message, sequence_++, options_.station))});
}

void MavlinkNode::on_pose(const PoseEvent& event, std::int64_t arrival_ns) {
  last_event_ns_ = arrival_ns;
  switch (event.state) {
    case TrackingState::starting:
      condition_ = Condition::starting;
      break;
    case TrackingState::lost:
      condition_ = Condition::lost;
      reason_ = event.reason;
      break;
    case TrackingState::tracking:
    case TrackingState::degraded:
      condition_ = event.scale == MapScale::metric ? Condition::metric : Condition::without_scale;
      break;
  }
  if (const auto message = odometry_.add(event, arrival_ns)) send(*message);
}

void MavlinkNode::on_bytes(std::span<const std::uint8_t> bytes, bool datagram,
                           std::int64_t now_ns) {
  const auto take = [&](const Packet& packet) { receive(packet, now_ns); };
  if (datagram) {
    parser_.feed_datagram(bytes, take);
  } else {
    parser_.feed(bytes, take);
  }
}

void MavlinkNode::receive(const Packet& packet, std::int64_t now_ns) {
  if (packet.from == options_.station) return;  // our own, come back from a router
  switch (packet.id) {
    case Heartbeat::kId:
      ++received_.heartbeats;
      break;
    case Timesync::kId:
      ++received_.timesyncs;
      receive(unpack<Timesync>(packet), packet.from, now_ns);
      break;
    case GpsRawInt::kId:
      ++received_.gps;
      if (packet.from.system == options_.station.system) {
        receive(unpack<GpsRawInt>(packet), now_ns);
      } else {
        ++received_.foreign;
      }
      break;
    default:
      ++received_.others;
  }
}

void MavlinkNode::receive(const Timesync& timesync, Station from, std::int64_t now_ns) {
  const Station& us = options_.station;
  if ((timesync.target_system != 0 && timesync.target_system != us.system) ||
      (timesync.target_component != 0 && timesync.target_component != us.component)) {
    return;
  }
  if (timesync.tc1 == 0) {
    send(Timesync{now_ns, timesync.ts1, from.system, from.component});
  } else if (from.system == us.system && asked_ns_ == timesync.ts1) {
    offset_.add(*asked_ns_, timesync.tc1, now_ns);
    asked_ns_.reset();
  }
}

void MavlinkNode::receive(const GpsRawInt& gps, std::int64_t now_ns) {
  if (positions_ == nullptr) return;
  if (gps.time_usec != 0 && std::exchange(last_gps_usec_, gps.time_usec) == gps.time_usec) return;
  const auto delay_ns = static_cast<std::int64_t>(1e9 * options_.gps_delay_s);
  const auto fix = position_fix(gps, fix_time_ns(gps, now_ns, offset_.offset_ns(), delay_ns));
  if (fix && positions_->push(*fix)) ++received_.positions;
}

void MavlinkNode::tick(std::int64_t now_ns) {
  if (condition_ != Condition::none && now_ns - last_event_ns_ >= kSilence_ns) {
    condition_ = Condition::silent;
  }
  if (now_ns >= next_beat_ns_) {
    next_beat_ns_ = now_ns + kSecond_ns;
    Heartbeat beat;
    beat.system_status = status();
    send(beat);
    send(Timesync{0, now_ns, 0, 0});
    asked_ns_ = now_ns;
  }
  if (condition_ != announced_ && now_ns >= next_words_ns_) {
    next_words_ns_ = now_ns + kSecond_ns;
    announced_ = condition_;
    send(words());
  }
  if (const auto message = odometry_.extrapolate(now_ns)) send(*message);
}

std::int64_t MavlinkNode::next_due_ns() const {
  std::int64_t due_ns = next_beat_ns_;
  if (condition_ != announced_) due_ns = std::min(due_ns, next_words_ns_);
  if (condition_ != Condition::none && condition_ != Condition::silent) {
    due_ns = std::min(due_ns, after(last_event_ns_, kSilence_ns));
  }
  if (const auto extrapolation_ns = odometry_.due_ns()) {
    due_ns = std::min(due_ns, *extrapolation_ns);
  }
  return due_ns;
}

std::vector<MavlinkOutgoing> MavlinkNode::take_outgoing() { return std::exchange(outgoing_, {}); }

SystemStatus MavlinkNode::status() const {
  switch (condition_) {
    case Condition::none:
      return SystemStatus::boot;
    case Condition::starting:
    case Condition::without_scale:
      return SystemStatus::standby;
    case Condition::metric:
      return SystemStatus::active;
    case Condition::lost:
    case Condition::silent:
      break;
  }
  return SystemStatus::critical;
}

StatusText MavlinkNode::words() const {
  switch (condition_) {
    case Condition::none:
    case Condition::starting:
      return StatusText::of(Severity::info, "Corvid: starting");
    case Condition::without_scale:
      return StatusText::of(Severity::info, "Corvid: tracking, scale not known yet");
    case Condition::metric:
      return StatusText::of(Severity::info, "Corvid: tracking, sending odometry");
    case Condition::lost:
      return StatusText::of(Severity::warning, "Corvid: lost: " + reason_);
    case Condition::silent:
      break;
  }
  return StatusText::of(Severity::warning, "Corvid: no pictures from the camera");
}

}  // namespace corvid
