#include "io/camera/mapped_buffer.h"

#include <gtest/gtest.h>
#include <libcamera/framebuffer.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>
#include <vector>

#include "io/camera/raw_image.h"

namespace corvid {
namespace {

/// Memory of which byte i is i.
libcamera::SharedFD memory_of(std::size_t size) {
  const int fd = memfd_create("buffer", 0);
  std::vector<std::uint8_t> bytes(size);
  for (std::size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::uint8_t>(i);
  EXPECT_EQ(write(fd, bytes.data(), size), static_cast<ssize_t>(size));
  const libcamera::SharedFD shared(fd);
  close(fd);
  return shared;
}

libcamera::FrameBuffer::Plane plane_of(const libcamera::SharedFD& fd, unsigned offset,
                                       unsigned length) {
  libcamera::FrameBuffer::Plane plane;
  plane.fd = fd;
  plane.offset = offset;
  plane.length = length;
  return plane;
}

TEST(MappedBuffer, PlanesThatFollowOneAnotherAreOne) {
  const libcamera::SharedFD fd = memory_of(96);
  const libcamera::FrameBuffer buffer({plane_of(fd, 0, 64), plane_of(fd, 64, 32)});
  const auto mapped = MappedBuffer::map(buffer);
  ASSERT_TRUE(mapped);
  std::uint32_t fourcc = fourcc_of("NV12");
  std::vector<std::size_t> used = {64, 30};
  auto planes = mapped->planes(used, 8, fourcc);
  EXPECT_EQ(fourcc_name(fourcc), "NV12");
  ASSERT_EQ(planes.size(), 1U);
  ASSERT_EQ(planes[0].bytes.size(), 94U);
  EXPECT_EQ(planes[0].stride_bytes, 8U);
  mapped->begin_read();
  EXPECT_EQ(planes[0].bytes[93], 93);
  mapped->end_read();
  // Cut short in the luma, or the driver says more than there is.
  used = {60, 0};
  EXPECT_EQ(mapped->planes(used, 8, fourcc)[0].bytes.size(), 60U);
  used = {1000, 1000};
  EXPECT_EQ(mapped->planes(used, 8, fourcc)[0].bytes.size(), 96U);
  EXPECT_EQ(mapped->planes({}, 8, fourcc)[0].bytes.size(), 0U);
}

TEST(MappedBuffer, PlanesThatLieApartStayApart) {
  const libcamera::SharedFD luma = memory_of(64), chroma = memory_of(48);
  const libcamera::FrameBuffer two({plane_of(luma, 0, 64), plane_of(chroma, 16, 32)});
  const auto mapped = MappedBuffer::map(two);
  ASSERT_TRUE(mapped);
  std::uint32_t fourcc = fourcc_of("NV12");
  const std::vector<std::size_t> used = {64, 32};
  const auto planes = mapped->planes(used, 8, fourcc);
  EXPECT_EQ(fourcc_name(fourcc), "NM12");
  ASSERT_EQ(planes.size(), 2U);
  EXPECT_EQ(planes[1].bytes[0], 16);
  EXPECT_EQ(planes[1].stride_bytes, 8U);
  Capture capture;
  ASSERT_TRUE(convert_raw(fourcc, 8, 8, planes, true, capture));
  EXPECT_EQ(capture.grey(3, 2), 19);

  const libcamera::FrameBuffer three(
      {plane_of(luma, 0, 64), plane_of(chroma, 0, 16), plane_of(chroma, 32, 16)});
  const auto mapped_three = MappedBuffer::map(three);
  ASSERT_TRUE(mapped_three);
  fourcc = fourcc_of("YU12");
  const std::vector<std::size_t> used_three = {64, 16, 16};
  const auto planes_three = mapped_three->planes(used_three, 8, fourcc);
  EXPECT_EQ(fourcc_name(fourcc), "YM12");
  ASSERT_EQ(planes_three.size(), 3U);
  EXPECT_EQ(planes_three[2].stride_bytes, 4U);
  EXPECT_EQ(planes_three[2].bytes[0], 32);
  ASSERT_TRUE(convert_raw(fourcc, 8, 8, planes_three, true, capture));
}

TEST(MappedBuffer, WhatCannotBeMappedIsAnError) {
  const libcamera::FrameBuffer buffer({plane_of(libcamera::SharedFD(), 0, 64)});
  const auto mapped = MappedBuffer::map(buffer);
  ASSERT_FALSE(mapped);
  EXPECT_EQ(mapped.error().code, ErrorCode::io);
}

}  // namespace
}  // namespace corvid
