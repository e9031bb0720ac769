#include "io/mavlink/packet.h"

#include "core/check.h"

namespace corvid::mavlink {
namespace {

constexpr std::uint8_t kMagic1 = 0xFE, kMagic2 = 0xFD;
constexpr std::size_t kHeader1 = 6, kHeader2 = 10, kCrc = 2, kSignature = 13;
constexpr std::uint8_t kSigned = 1;  // the only incompatibility flag there is

template <class... Message>
std::optional<std::uint8_t> crc_extra_among(std::uint32_t id) noexcept {
  std::optional<std::uint8_t> extra;
  ((id == Message::kId ? void(extra = Message::kCrcExtra) : void()), ...);
  return extra;
}

bool is_magic(std::uint8_t byte) { return byte == kMagic1 || byte == kMagic2; }

/// What the first bytes say of a packet.
struct Header {
  Packet packet;  // without its payload
  std::size_t header = 0, total = 0;
};

enum class HeaderState { good, cut, wrong };

/// @pre the first byte is a magic one.
HeaderState read_header(std::span<const std::uint8_t> bytes, Header* out) {
  Packet& p = out->packet;
  p.version = bytes[0] == kMagic1 ? 1 : 2;
  out->header = p.version == 1 ? kHeader1 : kHeader2;
  if (bytes.size() < out->header) return HeaderState::cut;
  p.length = bytes[1];
  out->total = out->header + p.length + kCrc;
  if (p.version == 1) {
    p.sequence = bytes[2], p.from = {bytes[3], bytes[4]}, p.id = bytes[5];
    return HeaderState::good;
  }
  if ((bytes[2] & ~kSigned) != 0) return HeaderState::wrong;
  if ((bytes[2] & kSigned) != 0) out->total += kSignature;
  p.sequence = bytes[4], p.from = {bytes[5], bytes[6]};
  p.id = bytes[7] | static_cast<std::uint32_t>(bytes[8]) << 8U |
         static_cast<std::uint32_t>(bytes[9]) << 16U;
  return HeaderState::good;
}

bool checksum_fits(std::span<const std::uint8_t> bytes, const Header& h, std::uint8_t extra) {
  const std::size_t end = h.header + h.packet.length;
  const std::uint16_t crc = crc16({&extra, 1}, crc16(bytes.subspan(1, end - 1)));
  return bytes[end] == (crc & 0xFFU) && bytes[end + 1] == crc >> 8U;
}

}  // namespace

std::uint16_t crc16(std::span<const std::uint8_t> bytes, std::uint16_t crc) noexcept {
  for (const std::uint8_t byte : bytes) {
    crc = static_cast<std::uint16_t>(crc ^ byte);
    for (int bit = 0; bit < 8; ++bit) {
      crc = static_cast<std::uint16_t>((crc & 1U) != 0 ? (crc >> 1U) ^ 0x8408U : crc >> 1U);
    }
  }
  return crc;
}

std::optional<std::uint8_t> crc_extra(std::uint32_t id) noexcept {
  return crc_extra_among<Heartbeat, GpsRawInt, Timesync, StatusText, Odometry>(id);
}

std::vector<std::uint8_t> to_bytes(const Packet& packet) {
  const auto extra = crc_extra(packet.id);
  CORVID_CHECK(extra, "only known messages can be sent");
  std::size_t length = packet.length;
  while (length > 1 && packet.payload[length - 1] == 0) --length;
  std::vector<std::uint8_t> bytes{kMagic2,
                                  static_cast<std::uint8_t>(length),
                                  0,
                                  0,
                                  packet.sequence,
                                  packet.from.system,
                                  packet.from.component,
                                  static_cast<std::uint8_t>(packet.id),
                                  static_cast<std::uint8_t>(packet.id >> 8U),
                                  static_cast<std::uint8_t>(packet.id >> 16U)};
  bytes.insert(bytes.end(), packet.payload.begin(),
               packet.payload.begin() + static_cast<std::ptrdiff_t>(length));
  const std::uint16_t crc = crc16({&*extra, 1}, crc16(std::span(bytes).subspan(1)));
  bytes.push_back(static_cast<std::uint8_t>(crc));
  bytes.push_back(static_cast<std::uint8_t>(crc >> 8U));
  return bytes;
}

void PacketParser::restart() {
  buffer_.clear();
  in_step_ = false;
}

void PacketParser::feed(std::span<const std::uint8_t> bytes, const Take& take) {
  buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
  run(false, take);
}

void PacketParser::feed_datagram(std::span<const std::uint8_t> bytes, const Take& take) {
  buffer_.assign(bytes.begin(), bytes.end());
  in_step_ = true;
  run(true, take);
}

void PacketParser::run(bool ends, const Take& take) {
  std::size_t at = 0;
  while (at < buffer_.size()) {
    const std::size_t used = step(std::span(buffer_).subspan(at), ends, take);
    if (used == 0) break;
    at += used;
  }
  buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(at));
}

std::size_t PacketParser::drop_byte() {
  in_step_ = false;
  ++counts_.garbage_bytes;
  return 1;
}

std::size_t PacketParser::step(std::span<const std::uint8_t> rest, bool ends, const Take& take) {
  if (!is_magic(rest[0])) return drop_byte();
  Header h;
  const HeaderState state = read_header(rest, &h);
  if (state == HeaderState::wrong) return drop_byte();
  if (state == HeaderState::cut || rest.size() < h.total) return ends ? drop_byte() : 0;
  const auto extra = crc_extra(h.packet.id);
  if (!extra) {
    if (!in_step_) return drop_byte();
    const bool last = rest.size() == h.total;
    if (last && !ends) return 0;
    if (!last && !is_magic(rest[h.total])) return drop_byte();
    ++counts_.unknown;
    return h.total;
  }
  if (!checksum_fits(rest, h, *extra)) {
    ++counts_.bad_crc;
    return drop_byte();
  }
  ++counts_.packets;
  in_step_ = true;
  std::copy_n(rest.begin() + static_cast<std::ptrdiff_t>(h.header), h.packet.length,
              h.packet.payload.begin());
  take(h.packet);
  return h.total;
}

}  // namespace corvid::mavlink
