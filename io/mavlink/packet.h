#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <concepts>
#include <cstdint>
#include <cstring>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "io/mavlink/messages.h"

namespace corvid::mavlink {

static_assert(std::endian::native == std::endian::little,
              "fields are copied as they lie in memory");

/// Where packets come from and go to.
struct Station {
  std::uint8_t system = 1;
  std::uint8_t component = 197;  ///< MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
  bool operator==(const Station&) const = default;
};

/// One message with its envelope opened. What a sender cut off or did not know is zero.
struct Packet {
  int version = 2;
  std::uint8_t sequence = 0;
  Station from;
  std::uint32_t id = 0;
  std::uint8_t length = 0;  ///< of the payload, as it was on the wire
  std::array<std::uint8_t, 255> payload{};
};

/// CRC-16/MCRF4XX: polynomial 0x1021 reflected, start 0xFFFF, nothing at the end.
[[nodiscard]] std::uint16_t crc16(std::span<const std::uint8_t> bytes,
                                  std::uint16_t crc = 0xFFFF) noexcept;
/// The byte that stands for a message's definition in its checksum; nothing for unknown messages.
[[nodiscard]] std::optional<std::uint8_t> crc_extra(std::uint32_t id) noexcept;

/// A packet of MAVLink 2, unsigned; zeros at the payload's end are cut, but for its first byte.
/// @pre the message is one of messages.h.
[[nodiscard]] std::vector<std::uint8_t> to_bytes(const Packet& packet);

template <class Message>
[[nodiscard]] Packet pack(const Message& message, std::uint8_t sequence, Station from) {
  Packet packet;
  packet.sequence = sequence;
  packet.from = from;
  packet.id = Message::kId;
  std::size_t at = 0;
  Message::fields(message, [&](const auto& field) {
    std::memcpy(packet.payload.data() + at, &field, sizeof field);
    at += sizeof field;
  });
  packet.length = static_cast<std::uint8_t>(at);
  return packet;
}

/// @pre the packet's id is the message's.
template <class Message>
[[nodiscard]] Message unpack(const Packet& packet) {
  Message message;
  std::size_t at = 0;
  Message::fields(message, [&](auto& field) {
    std::memcpy(&field, packet.payload.data() + at, sizeof field);
    at += sizeof field;
  });
  return message;
}

struct ParserCounts {
  std::uint64_t packets = 0;        ///< of known messages, with a checksum that fits
  std::uint64_t unknown = 0;        ///< of other messages, stepped over
  std::uint64_t bad_crc = 0;        ///< looked like a known message; cut and damaged ones, too
  std::uint64_t garbage_bytes = 0;  ///< that belong to no packet
};

/// Finds packets of MAVLink 1 and 2, signed ones too (the signature is not looked at), in a stream
/// that may contain anything.
///
/// The checksum of unknown messages cannot be checked. Such a packet is stepped over as a whole
/// only right behind a good one and in front of the beginning of another; everywhere else the
/// search goes on at the next byte, so that no garbage hides a good packet behind it.
class PacketParser {
 public:
  using Take = std::function<void(const Packet&)>;
  /// Bytes of a stream; a packet may come in pieces.
  void feed(std::span<const std::uint8_t> bytes, const Take& take);
  /// Bytes of a datagram, which holds whole packets.
  void feed_datagram(std::span<const std::uint8_t> bytes, const Take& take);
  /// Forgets a packet's beginning: the stream was opened anew.
  void restart();
  [[nodiscard]] const ParserCounts& counts() const { return counts_; }

 private:
  /// Bytes that are dealt with; 0: more have to come first, unless `ends`.
  [[nodiscard]] std::size_t step(std::span<const std::uint8_t> rest, bool ends, const Take& take);
  [[nodiscard]] std::size_t drop_byte();
  void run(bool ends, const Take& take);

  std::vector<std::uint8_t> buffer_;  // from the beginning of what may be a packet
  bool in_step_ = false;              // a good packet ended where the buffer begins
  ParserCounts counts_;
};

}  // namespace corvid::mavlink
