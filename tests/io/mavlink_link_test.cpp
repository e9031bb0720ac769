#include "io/mavlink/mavlink_link.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <thread>

#include "tests/io/mavlink_poses.h"

namespace corvid {
namespace {

using namespace mavlink;
using test::SteadyFlight;
using test::tracked;

/// The other end of a link: a socket, or a pseudo-terminal's master.
class OtherEnd {
 public:
  /// A UDP socket on a free port of this machine.
  static std::unique_ptr<OtherEnd> udp() {
    auto end = std::make_unique<OtherEnd>();
    end->fd_.reset(::socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0));
    sockaddr_in address = local(0);
    EXPECT_EQ(::bind(end->fd_.get(), reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    socklen_t length = sizeof address;
    ::getsockname(end->fd_.get(), reinterpret_cast<sockaddr*>(&address), &length);
    end->port = ntohs(address.sin_port);
    return end;
  }
  /// A new pseudo-terminal, whose other side is reached by a link at `path`.
  static std::unique_ptr<OtherEnd> terminal(const std::string& path) {
    auto end = std::make_unique<OtherEnd>();
    end->fd_.reset(::posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK));
    EXPECT_EQ(::grantpt(end->fd_.get()), 0);
    EXPECT_EQ(::unlockpt(end->fd_.get()), 0);
    std::filesystem::remove(path);
    std::filesystem::create_symlink(::ptsname(end->fd_.get()), path);
    return end;
  }
  /// As terminal(), but nothing can be written into it.
  static std::unique_ptr<OtherEnd> stopped_terminal(const std::string& path) {
    auto end = terminal(path + ".new");
    const Descriptor line(::open((path + ".new").c_str(), O_RDWR | O_NOCTTY));
    EXPECT_EQ(::tcflow(line.get(), TCOOFF), 0);
    std::filesystem::rename(path + ".new", path);
    return end;
  }
  void connect_to(int other_port) {
    const sockaddr_in address = local(other_port);
    ASSERT_EQ(::connect(fd_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  }
  void reply_to_sender() { connect_to(ntohs(sender_.sin_port)); }

  template <class Message>
  void say(const Message& message) {
    say_bytes(to_bytes(pack(message, 0, {1, 1})));
  }
  void say_bytes(const std::vector<std::uint8_t>& bytes) {
    ASSERT_EQ(::write(fd_.get(), bytes.data(), bytes.size()), static_cast<ssize_t>(bytes.size()));
  }
  /// Reads what is there, at most so many bytes.
  void read(std::size_t most = 65536) {
    std::vector<std::uint8_t> bytes(most);
    socklen_t length = sizeof sender_;
    const ssize_t n = port > 0 ? ::recvfrom(fd_.get(), bytes.data(), bytes.size(), 0,
                                            reinterpret_cast<sockaddr*>(&sender_), &length)
                               : ::read(fd_.get(), bytes.data(), bytes.size());
    if (n <= 0) return;
    parser.feed({bytes.data(), static_cast<std::size_t>(n)},
                [&](const Packet& p) { heard.push_back(p); });
  }
  /// Reads until something holds; gives up after half a minute.
  [[nodiscard]] bool until(const std::function<bool()>& holds) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(30);
    while (std::chrono::steady_clock::now() < end) {
      read();
      if (holds()) return true;
      pollfd p{fd_.get(), POLLIN, 0};
      ::poll(&p, 1, 10);
    }
    return false;
  }
  [[nodiscard]] std::size_t count(std::uint32_t id) const {
    return static_cast<std::size_t>(
        std::count_if(heard.begin(), heard.end(), [&](const Packet& p) { return p.id == id; }));
  }
  [[nodiscard]] bool until_heard(std::uint32_t id, std::size_t times = 1) {
    return until([&] { return count(id) >= times; });
  }

  int port = 0;
  std::vector<Packet> heard;
  PacketParser parser;

 private:
  static sockaddr_in local(int port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    return address;
  }
  Descriptor fd_;
  sockaddr_in sender_{};
};

class MavlinkLinkTest : public testing::Test {
 protected:
  std::unique_ptr<MavlinkLink> open(const std::string& spec) {
    const auto options = mavlink_options(spec);
    EXPECT_TRUE(options) << options.error().to_string();
    auto link = MavlinkLink::open(*options, clock_, &feed_);
    EXPECT_TRUE(link) << link.error().to_string();
    return link ? std::move(*link) : nullptr;
  }
  ErrorCode error_of(const std::string& spec) {
    const auto link = MavlinkLink::open(*mavlink_options(spec), clock_, &feed_);
    EXPECT_FALSE(link) << spec;
    EXPECT_FALSE(link.error().hint.empty()) << link.error().to_string();
    return link.error().code;
  }
  /// The next pose of a flight, taken now.
  void pose(MavlinkLink* link) {
    link->on_pose(tracked(clock_.now_ns(), SteadyFlight().at(0.01 * ++poses_)));
  }
  std::string path() const {
    return testing::TempDir() + testing::UnitTest::GetInstance()->current_test_info()->name() +
           ".tty";
  }

  SteadyClock clock_;
  PositionFeed feed_;
  int poses_ = 0;
};

TEST_F(MavlinkLinkTest, UdpBothWays) {
  const auto autopilot = OtherEnd::udp();
  const auto link = open(fmt::format("udp:127.0.0.1:{}", autopilot->port));
  ASSERT_TRUE(autopilot->until_heard(Heartbeat::kId));
  autopilot->reply_to_sender();
  autopilot->say(Timesync{0, 4711, 0, 0});
  ASSERT_TRUE(autopilot->until([&] {
    return std::any_of(autopilot->heard.begin(), autopilot->heard.end(), [](const Packet& p) {
      return p.id == Timesync::kId && unpack<Timesync>(p).ts1 == 4711;
    });
  }));
  GpsRawInt gps;
  gps.fix_type = 3;
  autopilot->say(gps);
  std::size_t fixes = 0;
  ASSERT_TRUE(autopilot->until([&] { return (fixes += feed_.take().size()) == 1; }));
  ASSERT_TRUE(autopilot->until([&] {
    pose(link.get());
    return autopilot->count(Odometry::kId) >= 20;
  }));
  // What was said is the clock's: microseconds of the capture.
  const auto last =
      unpack<Odometry>(*std::find_if(autopilot->heard.rbegin(), autopilot->heard.rend(),
                                     [](const Packet& p) { return p.id == Odometry::kId; }));
  EXPECT_LT(
      std::abs(static_cast<double>(last.time_usec) - 1e-3 * static_cast<double>(clock_.now_ns())),
      60e6);
  const MavlinkStatistics statistics = link->statistics();
  EXPECT_GE(statistics.sent, 22U);
  EXPECT_EQ(statistics.received.timesyncs, 1U);
  EXPECT_EQ(statistics.received.positions, 1U);
  EXPECT_EQ(statistics.failures, 0U);
  EXPECT_EQ(autopilot->parser.counts().bad_crc, 0U);
}

TEST_F(MavlinkLinkTest, ListeningAnswersWhoSpeaksMavlinkFirst) {
  const auto link = open("udpin:127.0.0.1:0");
  ASSERT_GT(link->local_port(), 0);
  const auto stranger = OtherEnd::udp(), autopilot = OtherEnd::udp(), late = OtherEnd::udp();
  for (const auto& end : {stranger.get(), autopilot.get(), late.get()}) {
    end->connect_to(link->local_port());
  }
  stranger->say_bytes({'h', 'e', 'l', 'l', 'o', 0xFD});
  ASSERT_TRUE(stranger->until([&] { return link->statistics().parser.garbage_bytes >= 6; }));
  autopilot->say(Heartbeat{});
  ASSERT_TRUE(autopilot->until_heard(Heartbeat::kId));
  late->say(Timesync{0, 1, 0, 0});
  ASSERT_TRUE(autopilot->until_heard(Timesync::kId, 2)) << "answers go to the partner";
  stranger->read();
  late->read();
  EXPECT_TRUE(stranger->heard.empty());
  EXPECT_TRUE(late->heard.empty());
}

TEST_F(MavlinkLinkTest, NobodyThereHoldsUpNobody) {
  int free_port = 0;
  { free_port = OtherEnd::udp()->port; }
  const auto link = open(fmt::format("udp:127.0.0.1:{}", free_port));
  for (int i = 0; i < 5000; ++i) pose(link.get());
  EXPECT_EQ(link->statistics().failures, 0U) << "who is not there yet may come";
  EXPECT_GT(link->statistics().replaced, 0U) << "the newest pose counts";
}

TEST_F(MavlinkLinkTest, SerialBothWays) {
  const auto autopilot = OtherEnd::terminal(path());
  const auto link = open("serial:" + path() + ":57600");
  ASSERT_TRUE(autopilot->until_heard(Heartbeat::kId));
  // Every byte goes through as it is: those that terminals treat specially, too.
  std::vector<std::uint8_t> all(256);
  for (int i = 0; i < 256; ++i) all[static_cast<std::size_t>(i)] = static_cast<std::uint8_t>(i);
  autopilot->say_bytes(all);
  ASSERT_TRUE(autopilot->until([&] {
    autopilot->say(Timesync{0, 0x0D0A11131A030407, 0, 0});
    return std::any_of(autopilot->heard.begin(), autopilot->heard.end(), [](const Packet& p) {
      return p.id == Timesync::kId && unpack<Timesync>(p).ts1 == 0x0D0A11131A030407;
    });
  }));
  ASSERT_TRUE(autopilot->until([&] {
    pose(link.get());
    return autopilot->count(Odometry::kId) >= 20;
  }));
  EXPECT_EQ(autopilot->parser.counts().garbage_bytes, 0U) << "nothing is echoed or changed";
}

TEST_F(MavlinkLinkTest, AFullSerialLineDropsWholePackets) {
  const auto autopilot = OtherEnd::terminal(path());
  const auto link = open("serial:" + path());
  for (int i = 0; link->statistics().dropped < 50; ++i) {
    ASSERT_LT(i, 100'000);
    pose(link.get());
    std::this_thread::sleep_for(std::chrono::microseconds(200));
  }
  ASSERT_TRUE(autopilot->until([&] {
    pose(link.get());
    return autopilot->count(Odometry::kId) >= 30 && autopilot->count(Heartbeat::kId) >= 2;
  }));
  EXPECT_EQ(autopilot->parser.counts().bad_crc, 0U);
  EXPECT_EQ(autopilot->parser.counts().garbage_bytes, 0U);
}

TEST_F(MavlinkLinkTest, ASerialLineThatWasPulledOutIsOpenedAgain) {
  auto autopilot = OtherEnd::terminal(path());
  const auto link = open("serial:" + path());
  ASSERT_TRUE(autopilot->until_heard(Heartbeat::kId));
  autopilot.reset();
  std::filesystem::remove(path());
  const auto second = OtherEnd::udp();  // only to wait with
  ASSERT_TRUE(second->until([&] {
    pose(link.get());
    return link->statistics().failures >= 2;  // gone, and not there yet
  }));
  EXPECT_NE(link->statistics().last_failure.find(path()), std::string::npos);
  autopilot = OtherEnd::terminal(path());
  ASSERT_TRUE(autopilot->until([&] {
    pose(link.get());
    return autopilot->count(Heartbeat::kId) >= 1 && autopilot->count(Odometry::kId) >= 5;
  }));
  EXPECT_EQ(link->statistics().reconnections, 1U);
}

TEST_F(MavlinkLinkTest, ALineThatOpensButBreaksAtOnceIsOpenedMoreAndMoreRarely) {
  auto autopilot = OtherEnd::stopped_terminal(path());
  const auto begun = std::chrono::steady_clock::now();
  const auto link = open("serial:" + path());
  const auto waiting = OtherEnd::udp();  // only to wait with
  for (std::uint64_t times = 1; times <= 3; ++times) {
    autopilot = OtherEnd::stopped_terminal(path());  // the one before it is gone
    ASSERT_TRUE(waiting->until([&] { return link->statistics().reconnections == times; }));
  }
  EXPECT_EQ(link->statistics().sent, 0U);
  // 0.25 s, 0.5 s, 1 s. At an even 0.25 s it would be there after 0.75 s.
  EXPECT_GE(std::chrono::steady_clock::now() - begun, std::chrono::milliseconds(1750));
  autopilot = OtherEnd::terminal(path());
  ASSERT_TRUE(autopilot->until_heard(Heartbeat::kId));
}

TEST_F(MavlinkLinkTest, WhatCannotBeOpenedIsSaid) {
  EXPECT_EQ(error_of("serial:/dev/no-such-line"), ErrorCode::not_found);
  EXPECT_EQ(error_of("serial:/dev/null"), ErrorCode::io) << "not a serial line";
  const auto terminal = OtherEnd::terminal(path());
  EXPECT_EQ(error_of("serial:" + path() + ":12345"), ErrorCode::invalid_argument);
  EXPECT_EQ(error_of("udp:no-such-host.invalid:14550"), ErrorCode::not_found);
  const auto taken = OtherEnd::udp();
  EXPECT_EQ(error_of(fmt::format("udpin:127.0.0.1:{}", taken->port)), ErrorCode::io);
}

}  // namespace
}  // namespace corvid
