#include "io/camera/v4l2_device.h"

#include <gtest/gtest.h>

#include "core/clock.h"
#include "io/camera/v4l2_camera.h"

namespace corvid {
namespace {

std::pair<unsigned, unsigned> fraction(double rate_hz) {
  const v4l2_fract interval = interval_of(rate_hz);
  return {interval.numerator, interval.denominator};
}

TEST(V4l2Device, RatesAsFractions) {
  EXPECT_EQ(fraction(30), std::pair(1u, 30u));
  EXPECT_EQ(fraction(29.97), std::pair(1001u, 30000u));
  EXPECT_EQ(fraction(59.94), std::pair(1001u, 60000u));
  EXPECT_EQ(fraction(23.976), std::pair(1001u, 24000u));
  EXPECT_EQ(fraction(12.5), std::pair(1000u, 12500u));
  EXPECT_EQ(fraction(0.5), std::pair(2000u, 1000u));
  EXPECT_EQ(rate_of({0, 30}), 0);
}

TEST(V4l2Device, WhatIsNoCameraIsAnErrorWithItsPath) {
  SteadyClock clock;
  CameraRequest request;
  request.device = "/dev/no-such-camera";
  const auto missing = open_v4l2(request, clock);
  ASSERT_FALSE(missing.has_value());
  EXPECT_EQ(missing.error().code, ErrorCode::not_found);
  EXPECT_EQ(missing.error().where, "/dev/no-such-camera");
  EXPECT_NE(missing.error().hint, "");
  request.device = "/dev/null";
  const auto other = open_v4l2(request, clock);
  ASSERT_FALSE(other.has_value());
  EXPECT_EQ(other.error().code, ErrorCode::unsupported);
}

}  // namespace
}  // namespace corvid
