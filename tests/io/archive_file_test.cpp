#include "io/archive_file.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <random>
#include <thread>

#include "tests/scenes/temporary_folder.h"

namespace corvid {
namespace {

std::vector<std::byte> noise(std::size_t size, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::byte> bytes(size);
  for (std::byte& b : bytes) b = static_cast<std::byte>(random());
  return bytes;
}

TEST(ArchiveFile, GivesBackWhatWasPut) {
  const TemporaryFolder folder;
  const auto archive = ArchiveFile::create(folder.path());
  ASSERT_TRUE(archive) << archive.error().to_string();
  std::vector<Archive::Slot> slots;
  for (unsigned i = 0; i < 50; ++i) {
    const auto slot = (*archive)->put(noise(977 * i, i));
    ASSERT_TRUE(slot);
    slots.push_back(*slot);
  }
  for (unsigned i = 0; i < 50; ++i) {
    const auto bytes = (*archive)->get(slots[i]);
    ASSERT_TRUE(bytes);
    EXPECT_EQ(*bytes, noise(977 * i, i)) << i;
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path())) << "the file has no name";
}

TEST(ArchiveFile, DroppedRoomIsUsedAgain) {
  const TemporaryFolder folder;
  const auto archive = ArchiveFile::create(folder.path());
  ASSERT_TRUE(archive);
  const auto first = (*archive)->put(noise(1000, 1)), second = (*archive)->put(noise(1000, 2));
  (*archive)->drop(*first);
  const auto third = (*archive)->put(noise(1000, 3));
  EXPECT_EQ((*archive)->size_bytes(), 2000U);
  EXPECT_EQ((*archive)->get(*second).value(), noise(1000, 2));
  EXPECT_EQ((*archive)->get(*third).value(), noise(1000, 3));
}

TEST(ArchiveFile, ManyThreads) {
  const TemporaryFolder folder;
  const auto archive = ArchiveFile::create(folder.path());
  ASSERT_TRUE(archive);
  std::vector<int> wrong(4, 0);
  {
    std::vector<std::jthread> threads;
    for (unsigned t = 0; t < 4; ++t)
      threads.emplace_back([&, t] {
        for (unsigned i = 0; i < 60; ++i) {
          const auto bytes = noise(500 + i % 3, 100 * t + i);
          const auto slot = (*archive)->put(bytes);
          if (!slot || (*archive)->get(*slot) != bytes) ++wrong[t];
          if (slot && i % 2 == 0) (*archive)->drop(*slot);
        }
      });
  }
  EXPECT_EQ(wrong, std::vector<int>(4, 0));
}

TEST(ArchiveFile, SaysWhyItCannotBe) {
  const TemporaryFolder folder;
  const auto archive = ArchiveFile::create(folder / "not-there");
  ASSERT_FALSE(archive);
  EXPECT_EQ(archive.error().code, ErrorCode::not_found);
  EXPECT_NE(archive.error().where.find("not-there"), std::string::npos);
}

TEST(ArchiveFile, ReadingBeyondItsEndIsAnError) {
  const TemporaryFolder folder;
  const auto archive = ArchiveFile::create(folder.path());
  ASSERT_TRUE(archive);
  const auto bytes = (*archive)->get({100, 10});
  ASSERT_FALSE(bytes);
  EXPECT_EQ(bytes.error().code, ErrorCode::io);
}

}  // namespace
}  // namespace corvid
