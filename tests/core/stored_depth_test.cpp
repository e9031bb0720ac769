#include "corvid/stored_depth.h"

#include <gtest/gtest.h>
#include <malloc.h>

#include <memory>
#include <vector>

#include "tests/scenes/memory_archive.h"

namespace corvid {
namespace {

DepthMap answers(int side) {
  DepthMap map;
  map.keyframe = KeyframeId(3);
  map.camera.width_px = map.camera.height_px = side;
  map.depth = FloatImage(side, side, 2.0F);
  map.confidence = FloatImage(side, side, 0.5F);
  map.depth(1, 2) = 7;
  map.depth(0, 0) = 0;  // no answer
  return map;
}

/// An archive that says yes and keeps nothing, so that only the depth maps themselves are counted.
class Nowhere final : public Archive {
 public:
  Expected<Slot> put(std::span<const std::byte>) override { return Slot{}; }
  Expected<std::vector<std::byte>> get(const Slot&) const override {
    return fail(ErrorCode::io, "nothing is kept");
  }
  void drop(const Slot&) override {}
};

std::size_t bytes_in_use() {
  const auto info = mallinfo2();
  return info.uordblks + info.hblkhd;
}

TEST(StoredDepth, ComesBackAsItWas) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  const DepthMap original = answers(5);
  StoredDepth stored(original);
  ASSERT_TRUE(stored.put_away(archive));
  EXPECT_FALSE(stored.in_memory());
  const auto back = stored.scaled();
  EXPECT_EQ(back->keyframe, original.keyframe);
  EXPECT_EQ(back->camera.width_px, 5);
  EXPECT_TRUE(back->depth == original.depth);
  EXPECT_TRUE(back->confidence == original.confidence);
  EXPECT_EQ(stored.answers().pixels, 25U);
  EXPECT_EQ(stored.answers().answered, 24U);
  EXPECT_EQ(stored.answers().confidence, 12);
  stored.scale = 2;
  EXPECT_EQ(stored.load().depth(1, 2), 14);
}

TEST(StoredDepth, WhatIsAwayTakesNoMemory) {
  const std::size_t empty = bytes_in_use();
  {
    const std::vector<std::byte> probe(1U << 22);
    if (bytes_in_use() < empty + probe.size())
      GTEST_SKIP() << "this allocator does not say what is in use (a sanitizer's)";
  }
  const auto archive = std::make_shared<Nowhere>();
  std::vector<StoredDepth> stored;
  const std::size_t before = bytes_in_use();
  for (int i = 0; i < 20; ++i) {
    stored.emplace_back(answers(500));
    ASSERT_TRUE(stored.back().put_away(archive));
  }
  EXPECT_LT(bytes_in_use() - before, stored.back().image_bytes() / 2)
      << "of 20 depth maps of 2 MB each";
}

}  // namespace
}  // namespace corvid
