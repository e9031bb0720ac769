#include <gtest/gtest.h>

#include <memory>
#include <stdexcept>

#include "corvid/frame.h"
#include "tests/scenes/memory_archive.h"

namespace corvid {
namespace {

FramePtr picture(bool colour) {
  auto frame = std::make_shared<Frame>();
  frame->id = FrameId(7);
  frame->time_ns = -5;
  frame->name = "a";
  frame->camera = std::make_shared<const Camera>();
  frame->grey = GreyImage(5, 3);
  for (std::size_t i = 0; i < 15; ++i) frame->grey.data()[i] = static_cast<std::uint8_t>(i * 7);
  if (colour) frame->colour = ColourImage(5, 3, Rgb8{1, 2, 3});
  if (colour) frame->colour(4, 2) = {9, 8, 7};
  return frame;
}

TEST(StoredFrame, ComesBackAsItWas) {
  for (const bool colour : {false, true}) {
    const auto archive = std::make_shared<testing::MemoryArchive>();
    const FramePtr original = picture(colour);
    const GreyImage grey = original->grey;
    const ColourImage colours = original->colour;
    const StoredFrame stored(original);
    EXPECT_EQ(stored.load(), original) << "nothing is copied while it is in memory";
    EXPECT_EQ(stored.image_bytes, colour ? 60U : 15U);
    ASSERT_TRUE(stored.put_away(archive));
    EXPECT_TRUE(stored.is_away());
    ASSERT_TRUE(stored.put_away(archive)) << "again";
    EXPECT_EQ(archive->kept.size(), 1U);
    const FramePtr back = stored.load();
    EXPECT_EQ(back->id, FrameId(7));
    EXPECT_EQ(back->time_ns, -5);
    EXPECT_EQ(back->name, "a");
    EXPECT_EQ(back->camera, original->camera);
    EXPECT_TRUE(back->grey == grey);
    EXPECT_TRUE(back->colour == colours);
    EXPECT_EQ(stored.load(), back) << "as long as somebody holds it, it is read once";
  }
}

TEST(StoredFrame, LetsGoOfThePictures) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  FramePtr original = picture(true);
  const std::weak_ptr<const Frame> watch = original;
  const StoredFrame stored(std::move(original));
  ASSERT_TRUE(stored.put_away(archive));
  EXPECT_TRUE(watch.expired());
  (void)stored.load();
  (void)stored.load();
  EXPECT_EQ(archive->reads, 2);
}

TEST(StoredFrame, KeepsWhatTheArchiveDoesNotTake) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  archive->room = 0;
  const StoredFrame stored(picture(true));
  EXPECT_FALSE(stored.put_away(archive));
  EXPECT_FALSE(stored.is_away());
  EXPECT_FALSE(stored.load()->grey.empty());
}

TEST(StoredFrame, SaysWhatItIsWithoutItsPictures) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  const StoredFrame stored(picture(true));
  ASSERT_TRUE(stored.put_away(archive));
  archive->broken = true;
  const FramePtr frame = stored.load();
  ASSERT_TRUE(frame);
  EXPECT_EQ(frame->id, FrameId(7));
  EXPECT_TRUE(frame->grey.empty());
  EXPECT_TRUE(frame->colour.empty());
}

TEST(StoredFrame, PicturesOfAnotherSizeAreLost) {
  for (const std::size_t size : {0U, 59U, 61U}) {
    const auto archive = std::make_shared<testing::MemoryArchive>();
    const StoredFrame stored(picture(true));
    ASSERT_TRUE(stored.put_away(archive));
    archive->kept.begin()->second.resize(size);
    const FramePtr frame = stored.load();
    EXPECT_EQ(frame->id, FrameId(7));
    EXPECT_TRUE(frame->grey.empty());
    EXPECT_TRUE(frame->colour.empty());
  }
}

TEST(StoredFrame, NeedsAFrame) { EXPECT_THROW(StoredFrame(nullptr), std::logic_error); }

}  // namespace
}  // namespace corvid
