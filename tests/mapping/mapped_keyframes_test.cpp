#include "mapping/mapped_keyframes.h"

#include <gtest/gtest.h>

#include "scenes/memory_archive.h"

namespace corvid {
namespace {

constexpr std::size_t kMapBytes = 2 * 8 * 4 * sizeof(float);

/// The n-th keyframe, with a depth map of 8 x 4 rays.
void add(MappedKeyframes& mapped, std::uint32_t n) {
  DepthMap depth;
  depth.keyframe = KeyframeId(n);
  depth.depth = depth.confidence = FloatImage(8, 4, static_cast<float>(n));
  Keyframe keyframe;
  keyframe.id = depth.keyframe;
  mapped.add(keyframe.id, {MapSnapshot(), keyframe, Camera(), StoredDepth(std::move(depth)), 1});
}

std::size_t in_memory(const MappedKeyframes& mapped) {
  std::size_t count = 0;
  for (const auto& [id, entry] : mapped.all()) count += entry.depth.in_memory() ? 1 : 0;
  return count;
}

TEST(MappedKeyframes, TheArchiveIsTriedAgainAfterAFailure) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  MappedKeyframes mapped(3 * kMapBytes, archive);
  std::uint32_t n = 0;
  for (; n < 10; ++n) add(mapped, n);
  EXPECT_EQ(in_memory(mapped), 3U);
  archive->room = archive->kept.size();
  add(mapped, n++);  // it fails
  archive->room.reset();
  for (int k = 0; k < 49; ++k) add(mapped, n++);
  EXPECT_EQ(in_memory(mapped), 53U) << "not yet";
  add(mapped, n++);
  EXPECT_EQ(in_memory(mapped), 3U);
  for (const auto& [id, entry] : mapped.all())
    EXPECT_EQ(entry.depth.load().depth(3, 3), static_cast<float>(id.value));
}

}  // namespace
}  // namespace corvid
