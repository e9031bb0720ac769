#include "io/mavlink/node.h"

#include <gtest/gtest.h>

#include <limits>
#include <string>

#include "io/mavlink/gps_fix.h"
#include "tests/io/mavlink_poses.h"

namespace corvid {
namespace {

using namespace mavlink;
using test::kMs;
using test::SteadyFlight;
using test::tracked;

constexpr Station kAutopilot{1, 1};
constexpr std::int64_t kStart_ns = 50'000 * kMs;

/// What a node said since the last call, decoded.
std::vector<Packet> said(MavlinkNode* node) {
  std::vector<Packet> packets;
  PacketParser parser;
  for (const MavlinkOutgoing& out : node->take_outgoing()) {
    parser.feed_datagram(out.bytes, [&](const Packet& p) { packets.push_back(p); });
    EXPECT_EQ(out.id, packets.back().id);
  }
  return packets;
}

template <class Message>
std::vector<Message> among(const std::vector<Packet>& packets) {
  std::vector<Message> messages;
  for (const Packet& p : packets) {
    if (p.id == Message::kId) messages.push_back(unpack<Message>(p));
  }
  return messages;
}

template <class Message>
void hear(MavlinkNode* node, const Message& message, std::int64_t now_ns,
          Station from = kAutopilot) {
  node->on_bytes(to_bytes(pack(message, 0, from)), true, now_ns);
}

/// Lets the node do all that is due until a time; what it said with when.
std::vector<std::pair<std::int64_t, Packet>> run(MavlinkNode* node, std::int64_t from_ns,
                                                 std::int64_t until_ns) {
  std::vector<std::pair<std::int64_t, Packet>> out;
  for (std::int64_t now_ns = from_ns; now_ns <= until_ns;
       now_ns = std::max(now_ns + 1, node->next_due_ns())) {
    node->tick(now_ns);
    for (const Packet& p : said(node)) out.emplace_back(now_ns, p);
  }
  return out;
}

std::string text(const StatusText& m) {
  return {m.text.data(), strnlen(m.text.data(), m.text.size())};
}

TEST(MavlinkNode, BeatsOnceASecondWithItsState) {
  MavlinkNode node({}, nullptr);
  const auto status = [&](std::int64_t now_ns) {
    node.tick(now_ns);
    const auto beats = among<Heartbeat>(said(&node));
    EXPECT_EQ(beats.size(), 1U);
    EXPECT_EQ(beats[0].type, 18);
    EXPECT_EQ(beats[0].autopilot, 8);
    return beats[0].system_status;
  };
  std::int64_t now = kStart_ns;
  EXPECT_EQ(status(now), SystemStatus::boot);
  PoseEvent starting;
  starting.time_ns = now;
  now += 900 * kMs;
  node.on_pose(starting, now);
  EXPECT_EQ(status(now += 100 * kMs), SystemStatus::standby);
  PoseEvent scaleless = tracked(now, Pose());
  scaleless.scale = MapScale::arbitrary;
  now += 900 * kMs;
  node.on_pose(scaleless, now);
  EXPECT_EQ(status(now += 100 * kMs), SystemStatus::standby);
  now += 900 * kMs;
  node.on_pose(tracked(now, Pose()), now);
  EXPECT_EQ(status(now += 100 * kMs), SystemStatus::active);
  now += 900 * kMs;
  node.on_pose(test::lost(now, "dark"), now);
  EXPECT_EQ(status(now += 100 * kMs), SystemStatus::critical);
  now += 100 * kMs;
  node.on_pose(tracked(now, Pose()), now);
  EXPECT_EQ(status(now += 1000 * kMs), SystemStatus::critical) << "no pictures for a second";
}

TEST(MavlinkNode, SaysChangesOfItsStateOnceAndNotTooOften) {
  MavlinkNode node({}, nullptr);
  std::vector<std::string> words;
  std::vector<Severity> severities;
  std::int64_t now = kStart_ns;
  for (int i = 0; i < 200; ++i, now += 50 * kMs) {
    // Tracking; lost from 2 s to 4 s; blinking from 4 s to 6 s; away from 8 s on.
    const bool is_lost = (i >= 40 && i < 80) || (i >= 80 && i < 120 && i % 2 == 0);
    if (i < 160)
      node.on_pose(is_lost ? test::lost(now, "dark") : tracked(now, SteadyFlight().at(0.05 * i)),
                   now);
    node.tick(now);
    for (const auto& m : among<StatusText>(said(&node))) {
      words.push_back(text(m));
      severities.push_back(m.severity);
    }
  }
  ASSERT_GE(words.size(), 4U);
  EXPECT_LE(words.size(), 7U);
  EXPECT_EQ(words[0], "Corvid: tracking, sending odometry");
  EXPECT_EQ(words[1], "Corvid: lost: dark");
  EXPECT_EQ(severities[1], Severity::warning);
  EXPECT_EQ(words.back(), "Corvid: no pictures from the camera");
}

TEST(MavlinkNode, SequencesRiseByOneAndComeFromUs) {
  MavlinkNodeOptions options;
  options.station = {9, 198};
  MavlinkNode node(options, nullptr);
  int expected = 0;
  for (int i = 0; i < 300; ++i) {
    node.tick(kStart_ns + i * 1000 * kMs);
    for (const Packet& p : said(&node)) {
      EXPECT_EQ(p.sequence, expected++ % 256);
      EXPECT_EQ(p.from, (Station{9, 198}));
    }
  }
  EXPECT_GT(expected, 512);
}

TEST(MavlinkNode, OdometryLeavesAtLeastThirtyTimesASecond) {
  MavlinkNode node({}, nullptr);
  std::vector<std::int64_t> times;
  for (int i = 0; i < 60; ++i) {
    const std::int64_t captured = kStart_ns + i * 50 * kMs, arrived = captured + 30 * kMs;
    node.on_pose(tracked(captured, SteadyFlight().at(0.05 * i)), arrived);
    for (const auto& [when, packet] : run(&node, arrived, arrived + 49 * kMs)) {
      if (packet.id == Odometry::kId) times.push_back(when);
    }
  }
  ASSERT_GT(times.size(), 100U);
  EXPECT_GE(static_cast<double>(times.size()), 30 * 60 * 0.05);
  for (std::size_t i = 20; i < times.size(); ++i) {
    EXPECT_LE(times[i] - times[i - 1], 34 * kMs) << i;
  }
}

TEST(MavlinkNode, AnswersQuestionsForTheTime) {
  MavlinkNode node({}, nullptr);
  hear(&node, Timesync{0, 777, 0, 0}, kStart_ns, {1, 1});
  hear(&node, Timesync{0, 778, 1, 197}, kStart_ns + 5, {255, 190});
  hear(&node, Timesync{0, 779, 2, 0}, kStart_ns);
  hear(&node, Timesync{0, 780, 1, 158}, kStart_ns);
  const auto answers = among<Timesync>(said(&node));
  ASSERT_EQ(answers.size(), 2U) << "the others are not for us";
  EXPECT_EQ(answers[0].tc1, kStart_ns);
  EXPECT_EQ(answers[0].ts1, 777);
  EXPECT_EQ(answers[1].tc1, kStart_ns + 5);
  EXPECT_EQ(answers[1].target_system, 255);
  EXPECT_EQ(answers[1].target_component, 190);
}

TEST(MavlinkNode, LearnsTheAutopilotsClockFromTheQuickestAnswer) {
  MavlinkNode node({}, nullptr);
  constexpr std::int64_t kAhead = -40'000 * kMs;
  EXPECT_FALSE(node.autopilot_offset_ns());
  for (int i = 0; i < 10; ++i) {
    const std::int64_t asked = kStart_ns + i * 1000 * kMs;
    node.tick(asked);
    const auto questions = among<Timesync>(said(&node));
    ASSERT_EQ(questions.size(), 1U);
    EXPECT_EQ(questions[0].tc1, 0);
    // 1 ms there, and 1 ms back, or much more.
    const std::int64_t back = i == 4 ? 1 * kMs : 50 * kMs;
    const Timesync answer{asked + 1 * kMs + kAhead, questions[0].ts1, 1, 197};
    // A reply that was somebody else's, and one that comes twice.
    hear(&node, Timesync{12345, questions[0].ts1 - 1, 0, 0}, asked + kMs);
    hear(&node, answer, asked + 1 * kMs + back);
    hear(&node, answer, asked + 900 * kMs);
  }
  ASSERT_TRUE(node.autopilot_offset_ns());
  EXPECT_EQ(*node.autopilot_offset_ns(), kAhead);
}

TEST(MavlinkNode, WildTimesDoNoHarm) {
  MavlinkNode node({}, nullptr);
  node.tick(kStart_ns);
  const auto asked = among<Timesync>(said(&node)).at(0).ts1;
  hear(&node, Timesync{INT64_MIN, asked, 0, 0}, kStart_ns + 1);
  EXPECT_FALSE(node.autopilot_offset_ns());
  hear(&node, Timesync{0, INT64_MIN, 0, 0}, kStart_ns);
  EXPECT_EQ(among<Timesync>(said(&node)).at(0).ts1, INT64_MIN);
  ClockOffset offset;
  offset.add(1000, INT64_MAX, 2000);
  EXPECT_EQ(offset.offset_ns(), INT64_MAX - 1500);
  GpsRawInt gps;
  gps.time_usec = UINT64_MAX;
  EXPECT_EQ(fix_time_ns(gps, kStart_ns, INT64_MAX, 7), kStart_ns - 7);
}

GpsRawInt some_gps() {
  GpsRawInt gps;
  gps.fix_type = 3;
  gps.lat = 473977420, gps.lon = -85455940, gps.alt = 488123;
  return gps;
}

TEST(MavlinkGps, CovarianceIsTheBestThatIsSaid) {
  GpsRawInt gps = some_gps();
  auto fix = position_fix(gps, 5);
  ASSERT_TRUE(fix);
  EXPECT_EQ(fix->time_ns, 5);
  EXPECT_DOUBLE_EQ(fix->position.latitude_deg, 47.397742);
  EXPECT_DOUBLE_EQ(fix->position.longitude_deg, -8.545594);
  EXPECT_DOUBLE_EQ(fix->position.altitude_m, 488.123);
  EXPECT_EQ(fix->covariance_m2, PositionFix().covariance_m2);
  gps.eph = 150, gps.epv = 200;
  fix = position_fix(gps, 5);
  EXPECT_NEAR(fix->covariance_m2(0, 0), 4.5 * 4.5, 1e-9);
  EXPECT_NEAR(fix->covariance_m2(2, 2), 36, 1e-9);
  gps.h_acc = 20, gps.v_acc = 50;
  fix = position_fix(gps, 5);
  EXPECT_NEAR(fix->covariance_m2(0, 0), 4e-4, 1e-12);
  EXPECT_NEAR(fix->covariance_m2(1, 1), 4e-4, 1e-12);
  EXPECT_NEAR(fix->covariance_m2(2, 2), 25e-4, 1e-12);
  EXPECT_EQ(fix->covariance_m2(0, 1), 0);
  EXPECT_TRUE(fix->problem().empty()) << fix->problem();
  for (const int type : {0, 1, 2}) {
    gps.fix_type = static_cast<std::uint8_t>(type);
    EXPECT_FALSE(position_fix(gps, 5));
  }
}

TEST(MavlinkGps, TimeIsTheMessagesWhereTheClocksAreKnown) {
  GpsRawInt gps = some_gps();
  constexpr std::int64_t kAhead = -40'000 * kMs, kDelay = 110 * kMs;
  const auto stamp = [&](std::int64_t ours_ns) {
    gps.time_usec = static_cast<std::uint64_t>((ours_ns + kAhead) / 1000);
  };
  stamp(kStart_ns - 60 * kMs);
  EXPECT_EQ(fix_time_ns(gps, kStart_ns, std::nullopt, kDelay), kStart_ns - kDelay);
  EXPECT_NEAR(static_cast<double>(fix_time_ns(gps, kStart_ns, kAhead, kDelay)),
              static_cast<double>(kStart_ns - 60 * kMs - kDelay), 1000);
  // The Unix epoch, missing, from the future: not to be believed.
  for (const std::uint64_t usec : {std::uint64_t{1'700'000'000'000'000}, std::uint64_t{0}}) {
    gps.time_usec = usec;
    EXPECT_EQ(fix_time_ns(gps, kStart_ns, kAhead, kDelay), kStart_ns - kDelay);
  }
  stamp(kStart_ns + 200 * kMs);
  EXPECT_EQ(fix_time_ns(gps, kStart_ns, kAhead, kDelay), kStart_ns - kDelay);
}

TEST(MavlinkNode, PositionsOfTheOwnVehicleGoToTheFeedOnce) {
  PositionFeed feed;
  MavlinkNode node({}, &feed);
  GpsRawInt gps = some_gps();
  gps.time_usec = 100;
  hear(&node, gps, kStart_ns);
  hear(&node, gps, kStart_ns + 100 * kMs);  // said again
  gps.time_usec = 200;
  hear(&node, gps, kStart_ns + 200 * kMs, {2, 1});    // another vehicle's
  hear(&node, gps, kStart_ns + 200 * kMs, {1, 197});  // our own packet, come back
  gps.fix_type = 2;
  hear(&node, gps, kStart_ns + 300 * kMs);
  gps = some_gps();
  gps.time_usec = 300;
  gps.lat = std::numeric_limits<std::int32_t>::max();  // 214 degrees north
  hear(&node, gps, kStart_ns + 400 * kMs);
  const std::vector<PositionFix> fixes = feed.take();
  ASSERT_EQ(fixes.size(), 1U);
  EXPECT_EQ(fixes[0].time_ns, kStart_ns - 110 * kMs);
  EXPECT_EQ(node.received().gps, 5U);
  EXPECT_EQ(node.received().foreign, 1U);
  EXPECT_EQ(node.received().positions, 1U);
  MavlinkNode without_feed({}, nullptr);
  hear(&without_feed, some_gps(), kStart_ns);
}

}  // namespace
}  // namespace corvid
