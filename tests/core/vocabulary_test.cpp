// Ids, images, errors, checks, the log and the map's look-up.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spdlog/sinks/ostream_sink.h>

#include <sstream>
#include <type_traits>
#include <unordered_set>

#include "core/check.h"
#include "core/log.h"
#include "corvid/error.h"
#include "corvid/ids.h"
#include "corvid/image.h"
#include "corvid/map.h"

namespace corvid {
namespace {

TEST(Id, KindsDoNotMixAndTheDefaultIsInvalid) {
  static_assert(!std::is_convertible_v<FrameId, TrackId>);
  static_assert(!std::is_convertible_v<std::uint32_t, FrameId>);
  static_assert(!std::is_constructible_v<TrackId, FrameId>);
  EXPECT_FALSE(FrameId().valid());
  EXPECT_TRUE(FrameId(0).valid());
  EXPECT_LT(TrackId(3), TrackId(4));
  EXPECT_EQ(TrackId(3), TrackId(3));
  EXPECT_GT(TrackId(), TrackId(4));
  const std::unordered_set<TrackId> set{TrackId(1), TrackId(2), TrackId(1)};
  EXPECT_EQ(set.size(), 2u);
}

TEST(Image, IsRowMajorWithoutPadding) {
  Image<int> image(3, 2, 7);
  EXPECT_EQ(image.size(), 6u);
  EXPECT_EQ(image(2, 1), 7);
  image(1, 1) = 5;
  EXPECT_EQ(image.data()[4], 5);
  EXPECT_EQ(image.row(1)[1], 5);
  EXPECT_EQ(image.row(1), image.data() + 3);
  EXPECT_TRUE(Image<int>().empty());
  EXPECT_FALSE(image.empty());
  EXPECT_NE(image, Image<int>(3, 2, 7));
  EXPECT_NE(Image<int>(2, 3), Image<int>(3, 2));
}

TEST(Image, ContainsCountsPixelCentres) {
  const GreyImage image(4, 3);
  EXPECT_TRUE(image.contains(0, 0));
  EXPECT_TRUE(image.contains(3, 2));
  EXPECT_FALSE(image.contains(3.01, 2));
  EXPECT_FALSE(image.contains(-0.01, 0));
  EXPECT_TRUE(image.contains(1, 1, 1));
  EXPECT_FALSE(image.contains(0.9, 1, 1));
}

TEST(Error, TextLeavesOutEmptyParts) {
  EXPECT_EQ((Error{ErrorCode::io, "cannot be opened", "a/b.png", "check the path"}).to_string(),
            "a/b.png: cannot be opened (check the path)");
  EXPECT_EQ((Error{ErrorCode::io, "cannot be opened", "", ""}).to_string(), "cannot be opened");
  EXPECT_EQ((Error{ErrorCode::io, "cannot be opened", "a", ""}).to_string(), "a: cannot be opened");
  EXPECT_EQ((Error{ErrorCode::io, "broken", "", "mend it"}).to_string(), "broken (mend it)");
}

TEST(Error, FailMakesAnyExpected) {
  const Expected<int> number = fail(ErrorCode::not_found, "no such file", "x", "look");
  ASSERT_FALSE(number);
  EXPECT_EQ(number.error().code, ErrorCode::not_found);
  EXPECT_EQ(number.error().where, "x");
  EXPECT_EQ(number.error().hint, "look");
  const Expected<void> nothing = fail(ErrorCode::io, "full");
  EXPECT_FALSE(nothing);
}

TEST(Check, ThrowsWithPlaceConditionAndMessage) {
  EXPECT_NO_THROW(CORVID_CHECK(1 + 1 == 2, "arithmetic"));
  try {
    CORVID_CHECK(1 + 1 == 3, "arithmetic");
    FAIL() << "did not throw";
  } catch (const std::logic_error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("vocabulary_test.cpp:"));
    EXPECT_THAT(error.what(), testing::HasSubstr("1 + 1 == 3: arithmetic"));
  }
}

TEST(Log, IsSilentUntilAProgramSetsALogger) {
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  log().error("nobody hears this");
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");

  std::ostringstream text;
  const auto silent = std::make_shared<spdlog::logger>("corvid");
  set_logger(std::make_shared<spdlog::logger>(
      "corvid", std::make_shared<spdlog::sinks::ostream_sink_st>(text)));
  log().warn("somebody hears {}", 42);
  log().flush();
  set_logger(silent);
  EXPECT_THAT(text.str(), testing::HasSubstr("somebody hears 42"));
}

TEST(MapSnapshot, FindsLandmarksById) {
  std::vector<Landmarks::Chunk> chunks;
  for (const std::uint32_t first : {2u, 5u, 9u}) {
    std::vector<Landmark> chunk(2);
    chunk[0].id = LandmarkId(first);
    chunk[1].id = LandmarkId(first + 1);
    chunks.push_back(std::make_shared<const std::vector<Landmark>>(chunk));
  }
  MapSnapshot map;
  map.landmarks = Landmarks(chunks);
  ASSERT_NE(map.find(LandmarkId(5)), nullptr);
  EXPECT_EQ(map.find(LandmarkId(5)), &chunks[1]->front());
  for (const std::uint32_t id : {0u, 4u, 7u, 11u}) EXPECT_EQ(map.find(LandmarkId(id)), nullptr);
  std::vector<std::uint32_t> ids;
  for (const Landmark& landmark : map.landmarks) ids.push_back(landmark.id.value);
  EXPECT_EQ(ids, (std::vector<std::uint32_t>{2, 3, 5, 6, 9, 10}));
  EXPECT_EQ(map.landmarks.size(), ids.size());
  EXPECT_EQ(MapSnapshot().find(LandmarkId(0)), nullptr);
}

TEST(TrackingState, HasNames) {
  EXPECT_EQ(to_string(TrackingState::starting), "starting");
  EXPECT_EQ(to_string(TrackingState::tracking), "tracking");
  EXPECT_EQ(to_string(TrackingState::degraded), "degraded");
  EXPECT_EQ(to_string(TrackingState::lost), "lost");
}

}  // namespace
}  // namespace corvid
