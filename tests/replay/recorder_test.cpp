#include "replay/recorder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "io/source.h"
#include "replay/async_recorder.h"
#include "scenes/rendered_views.h"

namespace corvid {
namespace {
namespace fs = std::filesystem;

class RecorderTest : public testing::Test {
 protected:
  void SetUp() override {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    folder = fs::path(testing::TempDir()) / ("corvid_recorder_" + std::string(test->name()));
    fs::remove_all(folder);
  }
  void TearDown() override { fs::remove_all(folder); }

  static FlightOptions options() {
    FlightOptions o = scenes::small_flight();
    o.width_px = 96;
    o.height_px = 64;
    o.duration_s = 0.25;
    o.start_time_ns = 1'403'638'127'245'096'960;
    return o;
  }
  /// What a reader makes of the folder.
  struct Replay {
    std::vector<FramePtr> frames;
    SourceCounts counts;
    Trajectory truth;
    SourceInfo info;
  };
  Replay replay() const {
    Replay result;
    auto source = open_source(folder.string());
    EXPECT_TRUE(source.has_value()) << (source ? "" : source.error().to_string());
    if (!source) return result;
    for (auto frame = (*source)->next(); frame && *frame; frame = (*source)->next())
      result.frames.push_back(*frame);
    result.counts = (*source)->counts();
    result.truth = (*source)->truth();
    result.info = (*source)->info();
    return result;
  }
  fs::path camera() const { return folder / "mav0" / "cam0"; }
  fs::path folder;
};

/// All of the flight as an ASL folder; the number of frames written.
std::uint64_t record(FrameSource& source, const fs::path& folder) {
  auto recorder = Recorder::open(folder, source.info());
  EXPECT_TRUE(recorder.has_value() && recorder->write_truth(source.truth()).has_value());
  AsyncRecorder async(std::make_unique<Recorder>(std::move(*recorder)), {});
  while (const FramePtr frame = source.next().value()) EXPECT_TRUE(async.push_waiting(frame, {}));
  EXPECT_TRUE(async.finish().has_value());
  return async.counts().written;
}

std::string read(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}
void write(const fs::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
}

TEST_F(RecorderTest, ARecordingComesBackExactly) {
  for (const CameraModel model :
       {CameraModel::pinhole, CameraModel::radtan, CameraModel::equidistant}) {
    for (const bool colour : {true, false}) {
      fs::remove_all(folder);
      FlightOptions o = options();
      o.model = model;
      o.colour = colour;
      SyntheticFlight flight(o);
      ASSERT_EQ(record(flight, folder), 5u);
      const Replay back = replay();
      ASSERT_EQ(back.frames.size(), 5u);
      EXPECT_EQ(back.counts.skipped, 0u) << testing::PrintToString(back.counts.messages);
      EXPECT_EQ(*back.info.camera, flight.camera());
      EXPECT_EQ(back.info.colour, colour);
      ASSERT_EQ(back.truth.size(), 5u);
      for (std::size_t i = 0; i < 5; ++i) {
        const FramePtr frame = flight.render(i);
        EXPECT_EQ(back.frames[i]->time_ns, frame->time_ns);
        EXPECT_EQ(back.frames[i]->grey, frame->grey);
        EXPECT_EQ(back.frames[i]->colour, frame->colour);
        EXPECT_EQ(back.truth[i].time_ns, frame->time_ns);
        EXPECT_TRUE(
            back.truth[i].T_world_camera.matrix().isApprox(flight.true_pose(i).matrix(), 1e-14));
      }
    }
  }
}

TEST_F(RecorderTest, AKilledRecordingIsReadUpToItsEnd) {
  SyntheticFlight flight(options());
  auto recorder = Recorder::open(folder, flight.info());
  ASSERT_TRUE(recorder.has_value());
  ASSERT_TRUE(recorder->write(*flight.next().value()).has_value());
  ASSERT_TRUE(recorder->write(*flight.next().value()).has_value());
  // Still open, as if killed here: everything written so far is on disk.
  EXPECT_EQ(replay().frames.size(), 2u);
  EXPECT_EQ(replay().counts.skipped, 0u);
  // Killed while an image was being written, and between an image and its line.
  const std::string image = read(camera() / "data" / "1403638127245096960.png");
  write(camera() / "data" / ".1403638127345096960.png.part", image.substr(0, image.size() / 2));
  write(camera() / "data" / "1403638127395096960.png", image);
  EXPECT_EQ(replay().frames.size(), 2u);
  EXPECT_EQ(replay().counts.skipped, 0u);
}

TEST_F(RecorderTest, WhatADiskCutOffIsSkippedAndCounted) {
  SyntheticFlight flight(options());
  ASSERT_EQ(record(flight, folder), 5u);
  const fs::path last = camera() / "data" / "1403638127445096960.png";
  const std::string image = read(last), list = read(camera() / "data.csv");
  ASSERT_FALSE(image.empty());
  write(last, image.substr(0, image.size() / 2));
  EXPECT_EQ(replay().frames.size(), 4u);
  EXPECT_EQ(replay().counts.skipped, 1u);
  write(last, image);
  // Anywhere within the last line: it is none, but all before it are.
  const std::size_t line = list.rfind('\n', list.size() - 2) + 1;
  for (std::size_t end = line + 1; end < list.size() - 1; ++end) {
    write(camera() / "data.csv", list.substr(0, end));
    const Replay cut = replay();
    EXPECT_EQ(cut.frames.size(), 4u) << end - line;
    EXPECT_EQ(cut.counts.skipped, 0u);
    EXPECT_THAT(cut.info.notes, testing::Contains(testing::HasSubstr("cut off")));
  }
  // Only its line feed is missing: it says all.
  write(camera() / "data.csv", list.substr(0, list.size() - 1));
  EXPECT_EQ(replay().frames.size(), 5u);
}

TEST_F(RecorderTest, RefusesWhatItCannotDo) {
  SyntheticFlight flight(options());
  {
    auto recorder = Recorder::open(folder, flight.info());
    ASSERT_TRUE(recorder.has_value());
    const FramePtr frame = flight.render(1);
    ASSERT_TRUE(recorder->write(*frame).has_value());
    EXPECT_EQ(recorder->write(*frame).error().code, ErrorCode::invalid_argument);
    EXPECT_EQ(recorder->write(*flight.render(0)).error().code, ErrorCode::invalid_argument);
    Frame early = *frame;
    early.time_ns = -1;
    EXPECT_FALSE(recorder->write(early).has_value());
    EXPECT_TRUE(recorder->write(*flight.render(2)).has_value());
  }
  const auto again = Recorder::open(folder, flight.info());
  ASSERT_FALSE(again.has_value());
  EXPECT_EQ(again.error().code, ErrorCode::invalid_argument);
  EXPECT_THAT(again.error().where, testing::HasSubstr("data.csv"));

  FlightOptions o = options();
  o.model = CameraModel::fov;
  const auto fov = Recorder::open(folder / "other", SyntheticFlight(o).info());
  ASSERT_FALSE(fov.has_value());
  EXPECT_EQ(fov.error().code, ErrorCode::unsupported);
  EXPECT_FALSE(fs::exists(folder / "other"));

  write(folder / "file", "");
  const auto blocked = Recorder::open(folder / "file", flight.info());
  ASSERT_FALSE(blocked.has_value());
  EXPECT_EQ(blocked.error().code, ErrorCode::invalid_argument);
}

TEST_F(RecorderTest, AGuessedCameraIsGuessedAgain) {
  SyntheticFlight flight(options());
  SourceInfo info = flight.info();
  info.intrinsics = IntrinsicsOrigin::guess;
  auto recorder = Recorder::open(folder, info);
  ASSERT_TRUE(recorder.has_value());
  ASSERT_TRUE(recorder->write(*flight.render(0)).has_value());
  EXPECT_EQ(replay().info.intrinsics, IntrinsicsOrigin::guess);
}

}  // namespace
}  // namespace corvid
