#include "io/video_recording.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "io/calibration.h"
#include "io/source.h"
#include "io/time_file.h"
#include "source_test_files.h"

namespace corvid {
namespace {

using test::read_text;
using test::TempFolder;
using test::write_text;
using testing::Contains;
using testing::HasSubstr;

constexpr int kWidth_px = 101, kHeight_px = 67;  // odd, as no codec likes it
constexpr std::int64_t kStart_ns = 1'403'638'127'245'096'961;

SourceInfo source_info(bool colour) {
  SourceInfo info;
  Camera camera;
  camera.model = CameraModel::radtan;
  camera.width_px = kWidth_px;
  camera.height_px = kHeight_px;
  camera.fx_px = 80.125;
  camera.fy_px = 81;
  camera.cx_px = 50;
  camera.cy_px = 33;
  camera.distortion = {0.1, -0.05, 0.001, 0.002, 0.01};
  info.camera = std::make_shared<const Camera>(camera);
  info.rate_hz = 20;
  info.colour = colour;
  return info;
}

/// Frames with pauses, some less than a millisecond apart.
Frame frame_of(int number, bool colour) {
  Frame frame;
  frame.id = FrameId(static_cast<std::uint32_t>(3 * number + 7));  // a camera that loses some
  frame.time_ns = kStart_ns + number * 50'000'123LL + (number % 3 == 2 ? -49'800'000 : 0) +
                  (number > 5 ? 3'600'000'000'000 : 0);
  frame.grey = GreyImage(kWidth_px, kHeight_px);
  std::uint32_t noise = static_cast<std::uint32_t>(number) * 2654435761u + 1;
  if (colour) frame.colour = ColourImage(kWidth_px, kHeight_px);
  for (int y = 0; y < kHeight_px; ++y) {
    for (int x = 0; x < kWidth_px; ++x) {
      noise = noise * 1664525u + 1013904223u;
      const auto value = static_cast<std::uint8_t>(number < 2 ? noise >> 24 : x + 2 * y + number);
      frame.grey(x, y) = value;
      if (!colour) continue;
      const Rgb8 pixel{value, static_cast<std::uint8_t>(noise >> 16),
                       static_cast<std::uint8_t>(255 - x)};
      frame.colour(x, y) = pixel;
    }
  }
  return frame;
}

struct Back {
  std::vector<FramePtr> frames;
  SourceInfo info;
  SourceCounts counts;
};
Back read_back(const std::string& path, const SourceOptions& options = {}) {
  Back back;
  auto source = open_source(path, options);
  EXPECT_TRUE(source.has_value()) << (source ? "" : source.error().to_string());
  if (!source) return back;
  for (auto frame = (*source)->next(); frame && *frame; frame = (*source)->next())
    back.frames.push_back(*frame);
  back.info = (*source)->info();
  back.counts = (*source)->counts();
  return back;
}

/// Ten frames; without `finish` as a process leaves them that was killed.
void record_ten(const std::string& path, VideoCodec codec, bool colour, bool finish = true) {
  auto recording = create_video_recording(path, codec, source_info(colour));
  ASSERT_TRUE(recording.has_value()) << recording.error().to_string();
  for (int i = 0; i < 10; ++i) {
    const auto written = (*recording)->write(frame_of(i, colour));
    ASSERT_TRUE(written.has_value()) << written.error().to_string();
  }
  if (finish) {
    const auto finished = (*recording)->finish();
    ASSERT_TRUE(finished.has_value()) << finished.error().to_string();
  }
}

TEST(VideoRecording, Ffv1ComesBackExactly) {
  for (const char* name : {"flight.mkv", "flight.avi"}) {
    for (const bool colour : {false, true}) {
      const TempFolder folder;
      record_ten(folder / name, VideoCodec::ffv1, colour);
      const Back back = read_back(folder / name);
      ASSERT_EQ(back.frames.size(), 10u) << name << colour;
      EXPECT_EQ(back.counts.skipped, 0u) << testing::PrintToString(back.counts.messages);
      EXPECT_EQ(back.info.frames, 10u);
      EXPECT_EQ(back.info.colour, colour);
      EXPECT_EQ(back.info.rate_hz, 20);
      EXPECT_EQ(*back.info.camera, *source_info(colour).camera);
      EXPECT_EQ(back.info.intrinsics, IntrinsicsOrigin::calibration);
      for (int i = 0; i < 10; ++i) {
        const Frame frame = frame_of(i, colour);
        const Frame& read = *back.frames[static_cast<std::size_t>(i)];
        EXPECT_EQ(read.time_ns, frame.time_ns) << name << i;
        if (colour) {
          EXPECT_EQ(read.colour, frame.colour) << name << i;
        } else {
          EXPECT_EQ(read.grey, frame.grey) << name << i;
          EXPECT_TRUE(read.colour.empty());
        }
      }
    }
  }
}

TEST(VideoRecording, MjpegIsCloseAndHasTheExactTimes) {
  for (const char* name : {"flight.mkv", "flight.avi"}) {
    for (const bool colour : {false, true}) {
      const TempFolder folder;
      record_ten(folder / name, VideoCodec::mjpeg, colour);
      const Back back = read_back(folder / name);
      ASSERT_EQ(back.frames.size(), 10u) << name << colour;
      EXPECT_EQ(back.info.colour, colour);
      for (int i = 0; i < 10; ++i) {
        const Frame frame = frame_of(i, colour);
        const Frame& read = *back.frames[static_cast<std::size_t>(i)];
        EXPECT_EQ(read.time_ns, frame.time_ns);
        if (i < 2 || colour) continue;  // noise has no likeness after a JPEG
        int most = 0;                   // the full range comes back: neither 16..235 nor a shift
        for (std::size_t k = 0; k < frame.grey.size(); ++k)
          most = std::max(most, std::abs(read.grey.data()[k] - frame.grey.data()[k]));
        EXPECT_LE(most, 40) << name << i;
        EXPECT_GT(most, 0);
      }
    }
  }
}

TEST(VideoRecording, WithoutItsEndItIsReadAsFarAsItGoes) {
  for (const char* name : {"flight.mkv", "flight.avi"}) {
    for (const VideoCodec codec : {VideoCodec::ffv1, VideoCodec::mjpeg}) {
      const TempFolder folder;
      auto recording = create_video_recording(folder / name, codec, source_info(false));
      ASSERT_TRUE(recording.has_value());
      for (int i = 0; i < 10; ++i) {
        ASSERT_TRUE((*recording)->write(frame_of(i, false)).has_value());
        // Whoever looks now, or a process that is killed now, has every frame so far.
        const Back back = read_back(folder / name);
        ASSERT_EQ(back.frames.size(), static_cast<std::size_t>(i + 1)) << name;
        EXPECT_EQ(back.counts.skipped, 0u) << testing::PrintToString(back.counts.messages);
        EXPECT_EQ(back.frames.back()->time_ns, frame_of(i, false).time_ns);
      }
    }
  }
}

TEST(VideoRecording, CutAnywhereNothingHalfIsTakenForWhole) {
  for (const char* name : {"flight.mkv", "flight.avi"}) {
    const TempFolder folder;
    record_ten(folder / name, VideoCodec::ffv1, false, false);
    const std::string video = read_text(folder / name);
    const std::string times = read_text(folder / "flight.times.csv");
    const auto first_end = static_cast<std::size_t>(
        read_time_file(folder / "flight.times.csv")->lines[0].bytes.value());
    for (std::size_t end = video.size() - 1; end >= first_end; end -= 977) {
      write_text(folder / name, video.substr(0, end));
      const Back back = read_back(folder / name);
      ASSERT_LT(back.frames.size(), 11u);
      EXPECT_EQ(back.counts.skipped + back.frames.size(), 10u) << end;
      for (std::size_t i = 0; i < back.frames.size(); ++i) {
        const Frame frame = frame_of(static_cast<int>(i), false);
        ASSERT_EQ(back.frames[i]->grey, frame.grey) << name << " " << end << " " << i;
        ASSERT_EQ(back.frames[i]->time_ns, frame.time_ns);
      }
    }
    // Half a line is none, even where its half is a number.
    write_text(folder / name, video);
    const std::size_t last = times.rfind('\n', times.size() - 2) + 1;
    for (std::size_t end = last + 1; end < times.size(); ++end) {
      write_text(folder / "flight.times.csv", times.substr(0, end));
      const Back back = read_back(folder / name);
      ASSERT_EQ(back.frames.size(), 9u);
      EXPECT_EQ(back.counts.skipped, 1u);
      EXPECT_THAT(back.counts.messages.front(), HasSubstr("no line in the time file"));
      EXPECT_THAT(back.info.notes, Contains(HasSubstr("cut off")));
    }
  }
}

TEST(VideoRecording, ADamagedFrameMovesNoOtherFramesTime) {
  for (const char* name : {"flight.mkv", "flight.avi"}) {
    const TempFolder folder;
    record_ten(folder / name, VideoCodec::mjpeg, false);
    std::string video = read_text(folder / name);
    std::size_t start = std::string::npos;  // of the fifth JPEG
    for (int i = 0; i < 5; ++i) start = video.find("\xFF\xD8\xFF", start + 1);
    const std::size_t end = video.find("\xFF\xD9", start);
    ASSERT_NE(end, std::string::npos);
    for (std::size_t at = start; at < end; ++at) video[at] = '\x11';
    write_text(folder / name, video);
    const Back back = read_back(folder / name);
    ASSERT_EQ(back.frames.size(), 9u) << name << testing::PrintToString(back.counts.messages);
    EXPECT_EQ(back.counts.skipped, 1u);
    for (int i = 0; i < 9; ++i) {
      const Frame frame = frame_of(i < 4 ? i : i + 1, false);
      EXPECT_EQ(back.frames[static_cast<std::size_t>(i)]->time_ns, frame.time_ns) << name << i;
    }
  }
}

TEST(VideoRecording, TheTimeFileDecidesWhatIsThere) {
  const TempFolder folder;
  const std::string video = folder / "flight.mkv", times = folder / "flight.times.csv";
  record_ten(video, VideoCodec::ffv1, false);
  // By hand, with numbers alone: frames 0, 1 and 4 have lines, 12 is not there, one is none.
  write_text(times, "# by hand\n0,100\n1,200\nnonsense\n4,500\n12,900\n");
  const Back back = read_back(video);
  ASSERT_EQ(back.frames.size(), 3u);
  EXPECT_EQ(back.info.frames, 4u);
  for (const auto& [i, number, time_ns] :
       {std::tuple(0, 0, 100), std::tuple(1, 1, 200), std::tuple(2, 4, 500)}) {
    EXPECT_EQ(back.frames[static_cast<std::size_t>(i)]->grey, frame_of(number, false).grey);
    EXPECT_EQ(back.frames[static_cast<std::size_t>(i)]->time_ns, time_ns);
  }
  EXPECT_EQ(back.counts.skipped, 7u + 1u + 1u);  // without lines, without a frame, not a line
  EXPECT_THAT(back.counts.messages, Contains(HasSubstr("flight.times.csv:4")));
  EXPECT_THAT(back.counts.messages, Contains(HasSubstr("frame 12 is in the time file")));

  write_text(times, "0,100\n1,200\n2,150\n3,300\n");  // a time that goes back
  EXPECT_EQ(read_back(video).frames.size(), 3u);
  write_text(times, "# nothing\n");
  const auto empty = open_source(video);
  ASSERT_FALSE(empty.has_value());
  EXPECT_THAT(empty.error().to_string(), HasSubstr("lists no frame"));
}

TEST(VideoRecording, SelectionGoesByTheFramesNumbers) {
  const TempFolder folder;
  record_ten(folder / "flight.mkv", VideoCodec::ffv1, false);
  SourceOptions options;
  options.first = 1;
  options.step = 3;
  options.count = 2;
  const Back back = read_back(folder / "flight.mkv", options);
  ASSERT_EQ(back.frames.size(), 2u);
  EXPECT_EQ(back.info.frames, 2u);
  EXPECT_EQ(back.counts.skipped, 0u);
  EXPECT_EQ(back.frames[0]->time_ns, frame_of(1, false).time_ns);
  EXPECT_EQ(back.frames[1]->time_ns, frame_of(4, false).time_ns);
  EXPECT_EQ(back.frames[1]->grey, frame_of(4, false).grey);
}

TEST(VideoRecording, RefusesWhatItCannotDo) {
  const TempFolder folder;
  const auto code = [&](const std::string& name, SourceInfo info) {
    const auto recording = create_video_recording(folder / name, VideoCodec::ffv1, info);
    return recording ? std::optional<ErrorCode>() : recording.error().code;
  };
  const SourceInfo info = source_info(false);
  EXPECT_EQ(code("flight.mp4", info), ErrorCode::invalid_argument);
  EXPECT_EQ(code("new/flight.mkv", info), std::nullopt);
  EXPECT_EQ(code("new/flight.mkv", info), ErrorCode::invalid_argument);  // is there already
  EXPECT_EQ(code("new/flight.avi", info), ErrorCode::invalid_argument);  // its time file is
  EXPECT_EQ(code("new/flight.times.csv/a.mkv", info), ErrorCode::invalid_argument);
  // A calibration that lies there: the same may stay, another may not be overwritten.
  ASSERT_TRUE(write_calibration(folder / "same.yaml", *info.camera, CalibrationFormat::opencv));
  EXPECT_EQ(code("same.mkv", info), std::nullopt);
  write_text(folder / "other.yaml", "mine\n");
  EXPECT_EQ(code("other.mkv", info), ErrorCode::invalid_argument);
  EXPECT_EQ(read_text(folder / "other.yaml"), "mine\n");
  // A guess stays a guess.
  SourceInfo guess = info;
  guess.intrinsics = IntrinsicsOrigin::guess;
  EXPECT_EQ(code("guess.mkv", guess), std::nullopt);
  EXPECT_FALSE(std::filesystem::exists(folder / "guess.yaml"));
  SourceInfo fov = info;
  Camera camera = *info.camera;
  camera.model = CameraModel::fov;
  camera.distortion = {0.9};
  fov.camera = std::make_shared<const Camera>(camera);
  EXPECT_EQ(code("fov.mkv", fov), std::nullopt);
  EXPECT_EQ(read_calibration(folder / "fov.yaml")->camera, camera);

  auto recording = create_video_recording(folder / "one.mkv", VideoCodec::ffv1, info);
  ASSERT_TRUE(recording.has_value());
  Frame frame = frame_of(1, false);
  EXPECT_TRUE((*recording)->write(frame).has_value());
  EXPECT_EQ((*recording)->write(frame).error().code, ErrorCode::invalid_argument);
  frame.time_ns += 1000;
  frame.grey = GreyImage(kWidth_px - 1, kHeight_px);
  EXPECT_EQ((*recording)->write(frame).error().code, ErrorCode::invalid_argument);
  EXPECT_TRUE((*recording)->write(frame_of(3, false)).has_value());
}

TEST(VideoRecording, WhatCannotBeBegunLeavesNothing) {
  namespace fs = std::filesystem;
  for (const bool had_camera : {false, true}) {
    const TempFolder folder;
    const SourceInfo info = source_info(false);
    if (had_camera) {
      ASSERT_TRUE(
          write_calibration(folder / "flight.yaml", *info.camera, CalibrationFormat::opencv));
    }
    fs::create_symlink(folder / "nowhere/times", folder / "flight.times.csv");
    const auto recording = create_video_recording(folder / "flight.mkv", VideoCodec::ffv1, info);
    ASSERT_FALSE(recording.has_value());
    EXPECT_EQ(recording.error().code, ErrorCode::not_found);
    EXPECT_FALSE(fs::exists(folder / "flight.mkv"));
    EXPECT_EQ(fs::exists(folder / "flight.yaml"), had_camera);
    EXPECT_TRUE(fs::is_symlink(folder / "flight.times.csv")) << "is not ours";
    fs::remove(folder / "flight.times.csv");
    record_ten(folder / "flight.mkv", VideoCodec::ffv1, false);
  }
}

}  // namespace
}  // namespace corvid
