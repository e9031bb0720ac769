#include "io/mavlink/mavlink_options.h"

#include <gtest/gtest.h>

namespace corvid {
namespace {

TEST(MavlinkOptions, ReadsTheKindsOfLinks) {
  auto o = mavlink_options("udp:127.0.0.1:14550");
  ASSERT_TRUE(o) << o.error().to_string();
  EXPECT_EQ(o->carrier, MavlinkCarrier::udp);
  EXPECT_EQ(o->place, "127.0.0.1");
  EXPECT_EQ(o->port_or_baud, 14550);
  EXPECT_EQ(o->node.station, (mavlink::Station{1, 197}));

  o = mavlink_options("udp:[fe80::1]:14550");
  ASSERT_TRUE(o) << o.error().to_string();
  EXPECT_EQ(o->place, "fe80::1");

  o = mavlink_options("udpin:14540");
  ASSERT_TRUE(o) << o.error().to_string();
  EXPECT_EQ(o->carrier, MavlinkCarrier::udp_listen);
  EXPECT_EQ(o->place, "0.0.0.0");
  EXPECT_EQ(o->port_or_baud, 14540);

  o = mavlink_options("udpin:127.0.0.1:14540");
  ASSERT_TRUE(o) << o.error().to_string();
  EXPECT_EQ(o->place, "127.0.0.1");

  o = mavlink_options("serial:/dev/ttyS0:57600");
  ASSERT_TRUE(o) << o.error().to_string();
  EXPECT_EQ(o->carrier, MavlinkCarrier::serial);
  EXPECT_EQ(o->place, "/dev/ttyS0");
  EXPECT_EQ(o->port_or_baud, 57600);

  o = mavlink_options("serial:/dev/serial/by-path/pci-0000:00:14.0-usb");
  ASSERT_TRUE(o) << o.error().to_string();
  EXPECT_EQ(o->place, "/dev/serial/by-path/pci-0000:00:14.0-usb");
  EXPECT_EQ(o->port_or_baud, 921600);
}

TEST(MavlinkOptions, ReadsOptions) {
  const auto o = mavlink_options(
      "udpin:14540,frame=ned,mount=down,lever=0.1/-0.2/"
      "0.05,rate=0,gps_delay=0.2,system=7,component=198");
  ASSERT_TRUE(o) << o.error().to_string();
  const Pose& mount = o->node.odometry.T_body_camera;
  EXPECT_TRUE((mount.rotation() * Eigen::Vector3d::UnitZ()).isApprox(Eigen::Vector3d(0, 0, 1)));
  EXPECT_TRUE(mount.translation().isApprox(Eigen::Vector3d(0.1, -0.2, 0.05)));
  EXPECT_EQ(o->node.odometry.rate_hz, 0);
  EXPECT_EQ(o->node.odometry.frame, mavlink::Frame::local_ned);
  EXPECT_EQ(o->node.gps_delay_s, 0.2);
  EXPECT_EQ(o->node.station, (mavlink::Station{7, 198}));

  const auto turned = mavlink_options("udpin:14540,mount=0/-90/0");
  ASSERT_TRUE(turned);
  EXPECT_TRUE(turned->node.odometry.T_body_camera.R().isApprox(mount.R()));
}

TEST(MavlinkOptions, SaysWhatIsWrong) {
  for (const char* spec : {"",
                           ":",
                           "tcp:127.0.0.1:14550",
                           "udp:",
                           "udp:14550",
                           "udp:host:",
                           "udp:host:0",
                           "udp:host:70000",
                           "udp:host:12x",
                           "udpin:",
                           "udpin:-1",
                           "serial:",
                           "serial::57600",
                           "serial:/dev/ttyS0:0",
                           "udpin:1,",
                           "udpin:1,rate",
                           "udpin:1,rate=",
                           "udpin:1,rate=nan",
                           "udpin:1,rate=-1",
                           "udpin:1,rate=1e9",
                           "udpin:1,mount=up",
                           "udpin:1,mount=1/2",
                           "udpin:1,mount=1/2/x",
                           "udpin:1,lever=1/2/3/4",
                           "udpin:1,lever=inf/0/0",
                           "udpin:1,system=0",
                           "udpin:1,system=256",
                           "udpin:1,component=x",
                           "udpin:1,gps_delay=9",
                           "udpin:1,frame=enu"}) {
    const auto o = mavlink_options(spec);
    ASSERT_FALSE(o) << spec;
    EXPECT_EQ(o.error().code, ErrorCode::invalid_argument) << spec;
    EXPECT_FALSE(o.error().what.empty());
    EXPECT_FALSE(o.error().hint.empty());
  }
  const auto typo = mavlink_options("udpin:1,mout=down");
  ASSERT_FALSE(typo);
  EXPECT_NE(typo.error().what.find("mount"), std::string::npos) << typo.error().what;
}

}  // namespace
}  // namespace corvid
