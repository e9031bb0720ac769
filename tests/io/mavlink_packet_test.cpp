#include "io/mavlink/packet.h"

#include <gtest/gtest.h>

#include <random>
#include <string_view>

namespace corvid::mavlink {
namespace {

using Bytes = std::vector<std::uint8_t>;

template <class Message>
Bytes bytes_of(const Message& message, std::uint8_t sequence = 7, Station from = {1, 1}) {
  return to_bytes(pack(message, sequence, from));
}

/// What a parser makes of bytes that come in pieces of `piece` bytes.
std::vector<Packet> parse(const Bytes& bytes, std::size_t piece, PacketParser* parser) {
  std::vector<Packet> packets;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    parser->feed(std::span(bytes).subspan(at, std::min(piece, bytes.size() - at)),
                 [&](const Packet& p) { packets.push_back(p); });
  }
  return packets;
}

std::vector<Packet> parse(const Bytes& bytes) {
  PacketParser parser;
  return parse(bytes, bytes.size(), &parser);
}

void append(Bytes* to, const Bytes& more) { to->insert(to->end(), more.begin(), more.end()); }

GpsRawInt some_fix() {
  GpsRawInt gps;
  gps.time_usec = 123456789;
  gps.lat = 473977420, gps.lon = -85455940, gps.alt = 488123;
  gps.eph = 121, gps.epv = 200, gps.fix_type = 3, gps.satellites_visible = 9;
  gps.h_acc = 1500, gps.v_acc = 2500;
  return gps;
}

/// MAVLink 2 with a message id that is not ours, its checksum anything.
Bytes unknown_packet(const Bytes& payload) {
  Bytes bytes{0xFD, static_cast<std::uint8_t>(payload.size()), 0, 0, 1, 1, 1, 30, 0, 0};
  append(&bytes, payload);
  append(&bytes, {0x12, 0x34});
  return bytes;
}

TEST(MavlinkPacket, ChecksumHasTheStandardsCheckValue) {
  constexpr std::string_view digits = "123456789";
  EXPECT_EQ(crc16({reinterpret_cast<const std::uint8_t*>(digits.data()), digits.size()}), 0x6F91);
}

TEST(MavlinkPacket, LengthsAreThoseOfTheDefinition) {
  EXPECT_EQ(pack(Heartbeat{}, 0, {}).length, Heartbeat::kLength);
  EXPECT_EQ(pack(GpsRawInt{}, 0, {}).length, GpsRawInt::kLength);
  EXPECT_EQ(pack(Timesync{}, 0, {}).length, Timesync::kLength);
  EXPECT_EQ(pack(StatusText{}, 0, {}).length, StatusText::kLength);
  EXPECT_EQ(pack(Odometry{}, 0, {}).length, Odometry::kLength);
}

TEST(MavlinkPacket, HeaderIsLaidOutAsInTheStandard) {
  Odometry m;
  m.time_usec = 0x0102030405060708;
  m.quality = 100;
  const Bytes bytes = bytes_of(m, 0xAB, {1, 197});
  ASSERT_EQ(bytes.size(), 10 + Odometry::kLength + 2);
  EXPECT_EQ(Bytes(bytes.begin(), bytes.begin() + 12),
            (Bytes{0xFD, 233, 0, 0, 0xAB, 1, 197, 0x4B, 0x01, 0x00, 0x08, 0x07}));
}

TEST(MavlinkPacket, ZerosAtTheEndAreCutButForTheFirstByte) {
  EXPECT_EQ(bytes_of(Timesync{}).size(), 10U + 1 + 2);
  EXPECT_EQ(bytes_of(Timesync{1, 0, 0, 0}).size(), 10U + 1 + 2);
  EXPECT_EQ(bytes_of(Timesync{256, 0, 0, 0}).size(), 10U + 2 + 2);
  EXPECT_EQ(bytes_of(Timesync{0, 0, 0, 5}).size(), 10U + 18 + 2);
  const std::vector<Packet> packets = parse(bytes_of(Timesync{256, 0, 0, 0}));
  ASSERT_EQ(packets.size(), 1U);
  EXPECT_EQ(packets[0].length, 2);
  EXPECT_EQ(unpack<Timesync>(packets[0]).tc1, 256);
  EXPECT_EQ(unpack<Timesync>(packets[0]).ts1, 0);
}

TEST(MavlinkPacket, FieldsComeBack) {
  const GpsRawInt sent = some_fix();
  const std::vector<Packet> packets = parse(bytes_of(sent, 200, {42, 220}));
  ASSERT_EQ(packets.size(), 1U);
  EXPECT_EQ(packets[0].sequence, 200);
  EXPECT_EQ(packets[0].from, (Station{42, 220}));
  const auto got = unpack<GpsRawInt>(packets[0]);
  EXPECT_EQ(got.time_usec, sent.time_usec);
  EXPECT_EQ(got.lat, sent.lat);
  EXPECT_EQ(got.lon, sent.lon);
  EXPECT_EQ(got.h_acc, sent.h_acc);
  EXPECT_EQ(got.satellites_visible, sent.satellites_visible);
}

TEST(MavlinkPacket, TextIsCutAtItsFieldsEnd) {
  const auto text = StatusText::of(Severity::warning, std::string(80, 'x'));
  EXPECT_EQ(text.text[49], 'x');
  const auto brief = StatusText::of(Severity::info, "ab");
  EXPECT_EQ(brief.text[1], 'b');
  EXPECT_EQ(brief.text[2], '\0');
}

TEST(MavlinkParser, ReadsVersionOne) {
  // A heartbeat of version 1: payload, then the checksum with the message's extra byte.
  Bytes bytes{0xFE, 9, 5, 3, 4, 0, 1, 2, 3, 4, 2, 12, 81, 4, 3};
  const std::uint8_t extra = Heartbeat::kCrcExtra;
  const std::uint16_t crc = crc16({&extra, 1}, crc16(std::span(bytes).subspan(1)));
  append(&bytes, {static_cast<std::uint8_t>(crc), static_cast<std::uint8_t>(crc >> 8)});
  const std::vector<Packet> packets = parse(bytes);
  ASSERT_EQ(packets.size(), 1U);
  EXPECT_EQ(packets[0].version, 1);
  EXPECT_EQ(packets[0].from, (Station{3, 4}));
  const auto beat = unpack<Heartbeat>(packets[0]);
  EXPECT_EQ(beat.custom_mode, 0x04030201U);
  EXPECT_EQ(beat.autopilot, 12);
  EXPECT_EQ(beat.system_status, SystemStatus::active);
}

TEST(MavlinkParser, StepsOverASignature) {
  Bytes bytes = bytes_of(some_fix());
  bytes[2] = 1;  // signed
  bytes.resize(bytes.size() - 2);
  const std::uint8_t extra = GpsRawInt::kCrcExtra;
  const std::uint16_t crc = crc16({&extra, 1}, crc16(std::span(bytes).subspan(1)));
  append(&bytes, {static_cast<std::uint8_t>(crc), static_cast<std::uint8_t>(crc >> 8)});
  append(&bytes, Bytes(13, 0xFD));
  append(&bytes, bytes_of(Heartbeat{}));
  EXPECT_EQ(parse(bytes).size(), 2U);
}

TEST(MavlinkParser, AnyPiecesWillDo) {
  Bytes bytes;
  for (int i = 0; i < 20; ++i) append(&bytes, bytes_of(some_fix(), static_cast<std::uint8_t>(i)));
  for (const std::size_t piece : {1U, 2U, 7U, 64U, 4096U}) {
    PacketParser parser;
    const std::vector<Packet> packets = parse(bytes, piece, &parser);
    ASSERT_EQ(packets.size(), 20U) << piece;
    for (std::size_t i = 0; i < 20; ++i) EXPECT_EQ(packets[i].sequence, i);
    EXPECT_EQ(parser.counts().garbage_bytes, 0U);
  }
}

TEST(MavlinkParser, DamagedPacketsAreRefused) {
  const Bytes good = bytes_of(some_fix());
  for (std::size_t at = 0; at < good.size(); ++at) {
    Bytes bytes = good;
    bytes[at] ^= 0x10;
    append(&bytes, Bytes(300, 0));
    EXPECT_TRUE(parse(bytes).empty()) << "byte " << at;
  }
}

TEST(MavlinkParser, UnknownMessagesAreSteppedOverWhole) {
  // A payload that holds a whole good packet: that must not come out, and nothing must be held up.
  PacketParser parser;
  Bytes bytes = bytes_of(Heartbeat{}, 1);
  append(&bytes, unknown_packet(bytes_of(some_fix())));
  append(&bytes, bytes_of(Heartbeat{}, 2));
  const std::vector<Packet> packets = parse(bytes, 3, &parser);
  ASSERT_EQ(packets.size(), 2U);
  EXPECT_EQ(packets[1].sequence, 2);
  EXPECT_EQ(parser.counts().unknown, 1U);
  EXPECT_EQ(parser.counts().garbage_bytes, 0U);
}

TEST(MavlinkParser, WhatOnlyLooksLikeAnUnknownMessageHidesNothing) {
  // Its length field reaches over the packets behind it.
  for (const bool after_a_good_one : {false, true}) {
    Bytes bytes;
    if (after_a_good_one) bytes = bytes_of(Heartbeat{}, 1);
    append(&bytes, {0xFD, 100, 0, 0, 1, 1, 1, 30, 0, 0});
    for (int i = 0; i < 10; ++i) append(&bytes, bytes_of(some_fix()));
    EXPECT_EQ(parse(bytes).size(), after_a_good_one ? 11U : 10U);
  }
}

TEST(MavlinkParser, ADatagramEndsWhatItBegan) {
  PacketParser parser;
  int packets = 0;
  const auto count = [&](const Packet&) { ++packets; };
  Bytes cut = bytes_of(some_fix());
  cut.resize(20);
  append(&cut, bytes_of(Heartbeat{}));
  parser.feed_datagram(cut, count);
  EXPECT_EQ(packets, 1) << "behind the beginning of one that never ends";
  parser.feed_datagram(unknown_packet(Bytes(5, 0xFD)), count);
  EXPECT_EQ(parser.counts().unknown, 1U);
  parser.feed_datagram({}, count);
  parser.feed_datagram(bytes_of(Heartbeat{}), count);
  EXPECT_EQ(packets, 2);
}

TEST(MavlinkParser, FindsEveryPacketBetweenGarbage) {
  std::mt19937 random(4);
  std::uniform_int_distribution<int> byte(0, 255), length(0, 400), piece(1, 300);
  PacketParser parser;
  std::size_t sent = 0, found = 0;
  Bytes stream;
  for (int round = 0; round < 2000; ++round) {
    for (int i = length(random); i > 0; --i) {
      // Beginnings of packets more often than chance has them.
      const int value = byte(random);
      stream.push_back(static_cast<std::uint8_t>(value < 8 ? 0xFD : value < 12 ? 0xFE : value));
    }
    GpsRawInt gps = some_fix();
    gps.time_usec = 1'000'000 + sent++;
    append(&stream, bytes_of(gps, static_cast<std::uint8_t>(round)));
  }
  append(&stream, Bytes(300, 0));  // so that no beginning waits for its end
  for (std::size_t at = 0; at < stream.size();) {
    const std::size_t n = std::min<std::size_t>(piece(random), stream.size() - at);
    parser.feed(std::span(stream).subspan(at, n), [&](const Packet& p) {
      if (p.id != GpsRawInt::kId) return;
      const auto gps = unpack<GpsRawInt>(p);
      if (gps.lat != some_fix().lat) return;
      EXPECT_EQ(gps.time_usec, 1'000'000 + found) << "in order";
      ++found;
    });
    at += n;
  }
  EXPECT_EQ(found, sent);
  EXPECT_LT(parser.counts().packets, sent + 20) << "garbage that has a good checksum by chance";
}

TEST(MavlinkParser, SurvivesPureGarbageOfAnyKind) {
  std::mt19937 random(5);
  for (const int lowest : {0, 0xF0, 0xFD}) {
    std::uniform_int_distribution<int> byte(lowest, 255);
    PacketParser parser;
    Bytes bytes(100'000);
    for (auto& b : bytes) b = static_cast<std::uint8_t>(byte(random));
    (void)parse(bytes, 997, &parser);
    PacketParser datagrams;
    for (std::size_t at = 0; at + 200 <= bytes.size(); at += 200) {
      datagrams.feed_datagram(std::span(bytes).subspan(at, 200), [](const Packet&) {});
    }
    append(&bytes, Bytes(300, 0));
    append(&bytes, bytes_of(Heartbeat{}, 99));
    int last = -1;
    parser.feed(Bytes(bytes.end() - 330, bytes.end()), [&](const Packet& p) { last = p.sequence; });
    EXPECT_EQ(last, 99);
  }
}

}  // namespace
}  // namespace corvid::mavlink
