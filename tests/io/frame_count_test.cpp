#include "io/camera/frame_count.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <string>

namespace corvid {
namespace {

TEST(FrameCount, CountsGapsAsLost) {
  FrameCount count;
  EXPECT_EQ(count.came(3), 3U) << "what was before the first is nobody's loss";
  EXPECT_EQ(count.came(4), 4U);
  EXPECT_EQ(count.came(8), 8U);
  EXPECT_EQ(count.counts().lost, 3U);
}

TEST(FrameCount, GoesOnBeyond32BitsAndOverARestart) {
  FrameCount count;
  EXPECT_EQ(count.came(0xfffffffe), 0xfffffffeU);
  EXPECT_EQ(count.came(1), 0x100000001U);
  EXPECT_EQ(count.counts().lost, 2U);
  EXPECT_EQ(count.came(0), 0x100000002U) << "back";
  EXPECT_EQ(count.came(0), 0x100000003U) << "the same again";
  EXPECT_EQ(count.counts().lost, 2U);
}

TEST(FrameCount, KeepsTheFirstMessages) {
  FrameCount count;
  for (std::uint32_t i = 0; i < 300; ++i) count.damaged(count.came(i), "cut short");
  EXPECT_EQ(count.counts().damaged, 300U);
  EXPECT_EQ(count.counts().lost, 0U);
  ASSERT_EQ(count.counts().messages.size(), 100U);
  EXPECT_EQ(count.counts().messages[7], "picture 7: cut short");
}

}  // namespace
}  // namespace corvid
