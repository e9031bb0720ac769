#include "engine/image_store.h"

#include <gtest/gtest.h>

#include "tests/scenes/memory_archive.h"

namespace corvid {
namespace {

/// Keyframes with pictures of 100 bytes.
void add_keyframes(MapSnapshot& map, std::size_t size) {
  while (map.keyframes.size() < size) {
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(map.keyframes.size()));
    frame->grey = GreyImage(10, 10, static_cast<std::uint8_t>(map.keyframes.size()));
    auto keyframe = std::make_shared<Keyframe>();
    keyframe->frame = std::make_shared<const StoredFrame>(frame);
    map.keyframes.push_back(keyframe);
  }
}

std::size_t in_memory(const MapSnapshot& map) {
  std::size_t count = 0;
  for (const auto& keyframe : map.keyframes) count += keyframe->frame->is_away() ? 0 : 1;
  return count;
}

TEST(ImageStore, KeepsTheNewestInMemory) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  ImageStore store(archive, 350);
  MapSnapshot map;
  for (const std::size_t size : {2U, 5U, 40U, 41U}) {
    add_keyframes(map, size);
    store.trim(map);
    EXPECT_EQ(in_memory(map), std::min<std::size_t>(size, 3));
    EXPECT_FALSE(map.keyframes.back()->frame->is_away());
  }
  EXPECT_EQ(archive->kept.size(), 38U);
  for (std::size_t i = 0; i < map.keyframes.size(); ++i)
    EXPECT_EQ(map.keyframes[i]->frame->load()->grey(3, 3), i);
}

TEST(ImageStore, WithoutAnArchiveAllStays) {
  ImageStore store(nullptr, 1);
  MapSnapshot map;
  add_keyframes(map, 5);
  store.trim(map);
  EXPECT_EQ(in_memory(map), 5U);
}

TEST(ImageStore, SaysThatTheArchiveFailed) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  archive->room = 0;
  ImageStore store(archive, 250);
  MapSnapshot map;
  add_keyframes(map, 5);
  store.trim(map);
  ASSERT_TRUE(store.failure());
  EXPECT_EQ(store.failure()->what, "no room");
  EXPECT_EQ(in_memory(map), 5U);
}

TEST(ImageStore, TriesAgainWhenTheDiskMayHaveRoom) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  ImageStore store(archive, 250);
  MapSnapshot map;
  add_keyframes(map, 10);
  archive->room = 3;
  store.trim(map);
  EXPECT_EQ(in_memory(map), 7U);
  archive->room.reset();
  add_keyframes(map, 59);
  store.trim(map);
  EXPECT_EQ(in_memory(map), 56U) << "not yet";
  add_keyframes(map, 60);
  store.trim(map);
  EXPECT_EQ(in_memory(map), 2U);
  EXPECT_EQ(archive->kept.size(), 58U);
  EXPECT_TRUE(store.failure()) << "for the notes of the run";
}

}  // namespace
}  // namespace corvid
