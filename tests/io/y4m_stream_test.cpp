#include "io/camera/y4m_stream.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <string>
#include <thread>
#include <vector>

#include "io/camera/y4m_header.h"
#include "source_test_files.h"

namespace corvid {
namespace {

using namespace std::chrono_literals;
using test::TempFolder;
using testing::HasSubstr;
using testing::IsEmpty;

/// The test's end of a pipe that is the standard input for as long as it lives.
class PipedInput {
 public:
  PipedInput() {
    int ends[2];
    EXPECT_EQ(::pipe2(ends, O_CLOEXEC), 0);
    saved_ = ::dup(STDIN_FILENO);
    ::dup2(ends[0], STDIN_FILENO);
    ::close(ends[0]);
    fd_ = ends[1];
  }
  ~PipedInput() {
    end();
    ::dup2(saved_, STDIN_FILENO);
    ::close(saved_);
  }
  void write(const std::string& bytes) {
    ASSERT_EQ(::write(fd_, bytes.data(), bytes.size()), static_cast<ssize_t>(bytes.size()));
  }
  void end() {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }

 private:
  int fd_ = -1, saved_ = -1;
};

CameraRequest standard_input(bool colour = false) {
  CameraRequest request;
  request.device = "-";
  request.colour = colour;
  return request;
}

std::string luma(int frame, std::size_t count = 12) {
  std::string bytes;
  for (std::size_t i = 0; i < count; ++i)
    bytes += static_cast<char>((40 * frame + 17 * static_cast<int>(i)) % 256);
  return bytes;
}
std::string mono_frame(int frame) { return "FRAME\n" + luma(frame); }
const std::string kMono = "YUV4MPEG2 W4 H3 F20:1 Ip A1:1 Cmono\n";

std::string grey_bytes(const Capture& capture) {
  return {reinterpret_cast<const char*>(capture.grey.data()), capture.grey.size()};
}

TEST(Y4mStream, TornIntoBytesItIsTheSame) {
  ManualClock clock;
  clock.advance(7'000'000'000);
  PipedInput pipe;
  const std::string bytes = kMono + mono_frame(0) + "FRAME Ip Xnote\n" + luma(1) + mono_frame(2);
  pipe.write(kMono.substr(0, 5));
  std::jthread writer([&] {
    for (std::size_t i = 5; i < bytes.size(); ++i) {
      pipe.write(bytes.substr(i, 1));
      if (i % 8 == 0) std::this_thread::sleep_for(1ms);
    }
    pipe.end();
  });
  auto stream = open_y4m(standard_input(), clock);
  ASSERT_TRUE(stream.has_value()) << stream.error().to_string();
  EXPECT_EQ((*stream)->settings().format, "y4m mono");
  EXPECT_EQ((*stream)->settings().width_px, 4);
  EXPECT_EQ((*stream)->settings().height_px, 3);
  EXPECT_EQ((*stream)->settings().rate_hz, 20);
  for (int i = 0; i < 3;) {
    auto capture = (*stream)->next(1ms, {});
    ASSERT_TRUE(capture.has_value()) << capture.error().to_string();
    if (!*capture) {
      ASSERT_FALSE((*stream)->ended());
      continue;
    }
    EXPECT_EQ(grey_bytes(**capture), luma(i));
    EXPECT_EQ((*capture)->sequence, static_cast<std::uint64_t>(i));
    EXPECT_EQ((*capture)->time_ns, 7'000'000'000 + i * 50'000'000);
    clock.advance(50'000'000);
    ++i;
  }
  EXPECT_FALSE((*stream)->next(1000ms, {}).value().has_value());
  EXPECT_TRUE((*stream)->ended());
  EXPECT_EQ((*stream)->counts().damaged, 0u);
}

TEST(Y4mStream, ALastFrameThatIsCutOffIsDamaged) {
  ManualClock clock;
  for (const std::string& torn :
       {std::string("FR"), std::string("FRAME\n"), "FRAME\n" + luma(1, 11)}) {
    PipedInput pipe;
    pipe.write(kMono + mono_frame(0) + torn);
    pipe.end();
    auto stream = open_y4m(standard_input(), clock);
    ASSERT_TRUE(stream.has_value());
    EXPECT_TRUE((*stream)->next(1000ms, {}).value().has_value());
    EXPECT_FALSE((*stream)->ended());
    EXPECT_FALSE((*stream)->next(1000ms, {}).value().has_value());
    EXPECT_TRUE((*stream)->ended());
    EXPECT_EQ((*stream)->counts().damaged, 1u);
    EXPECT_THAT((*stream)->counts().messages.front(), HasSubstr("frame 1 is cut off"));
    EXPECT_FALSE((*stream)->next(1000ms, {}).value().has_value());
    EXPECT_EQ((*stream)->counts().damaged, 1u);
  }
}

TEST(Y4mStream, AWriterThatHangsHoldsNothing) {
  ManualClock clock;
  PipedInput pipe;
  pipe.write(kMono + "FRAME\n" + luma(0, 5));  // and then nothing
  auto stream = open_y4m(standard_input(), clock);
  ASSERT_TRUE(stream.has_value());
  EXPECT_FALSE((*stream)->next(20ms, {}).value().has_value());  // the timeout is kept
  EXPECT_FALSE((*stream)->ended());
  std::stop_source stop;
  std::jthread asker([&] {
    std::this_thread::sleep_for(30ms);
    stop.request_stop();
  });
  // Would wait for ten minutes; the test's own time limit tells.
  EXPECT_FALSE((*stream)->next(600'000ms, stop.get_token()).value().has_value());
  EXPECT_FALSE((*stream)->ended());
  pipe.write(luma(0).substr(5));
  EXPECT_EQ(grey_bytes(*(*stream)->next(1000ms, {}).value()), luma(0));
}

TEST(Y4mStream, StopEndsTheWaitForAHeader) {
  ManualClock clock;
  const TempFolder folder;
  const std::string fifo = folder / "fifo";
  ASSERT_EQ(::mkfifo(fifo.c_str(), 0600), 0);  // that nobody writes to
  CameraRequest request;
  request.device = fifo;
  std::stop_source stop;
  std::jthread asker([&] {
    std::this_thread::sleep_for(30ms);
    stop.request_stop();
  });
  const auto stream = open_y4m(request, clock, stop.get_token());
  ASSERT_FALSE(stream.has_value());
  EXPECT_EQ(stream.error().code, ErrorCode::interrupted);
}

TEST(Y4mStream, AFifoIsReadWhenItsWriterComes) {
  ManualClock clock;
  const TempFolder folder;
  const std::string fifo = folder / "fifo";
  ASSERT_EQ(::mkfifo(fifo.c_str(), 0600), 0);
  std::jthread writer([&] {
    std::this_thread::sleep_for(80ms);
    test::write_text(fifo, kMono + mono_frame(0));
  });
  CameraRequest request;
  request.device = fifo;
  auto stream = open_y4m(request, clock);
  ASSERT_TRUE(stream.has_value()) << stream.error().to_string();
  EXPECT_TRUE((*stream)->next(1000ms, {}).value().has_value());
  EXPECT_FALSE((*stream)->next(1000ms, {}).value().has_value());
  EXPECT_TRUE((*stream)->ended());
}

TEST(Y4mStream, TimesAreCountedAndBeginAnewAfterAPause) {
  ManualClock clock;
  PipedInput pipe;
  std::string bytes = "YUV4MPEG2 W4 H3 F30000:1001 Cmono\n";
  for (int i = 0; i < 7; ++i) bytes += mono_frame(i);
  pipe.write(bytes);
  auto stream = open_y4m(standard_input(), clock);
  ASSERT_TRUE(stream.has_value());
  const auto time_ns = [&] { return (*stream)->next(1000ms, {}).value()->time_ns; };
  clock.advance(1'000'000'000);
  EXPECT_EQ(time_ns(), 1'000'000'000);
  clock.advance(50'000'000);
  EXPECT_EQ(time_ns(), 1'033'366'666);  // 1001 / 30000 s later, though it came later
  clock.advance(450'000'000);           // within what a pipe may lag
  EXPECT_EQ(time_ns(), 1'066'733'333);
  clock.advance(3'000'000'000);
  EXPECT_EQ(time_ns(), 4'500'000'000);
  clock.advance(40'000'000);
  EXPECT_EQ(time_ns(), 4'533'366'666);
  // One that comes early shows that those before it were late.
  EXPECT_EQ(time_ns(), 4'540'000'000);
  clock.advance(40'000'000);
  EXPECT_EQ(time_ns(), 4'573'366'667);
}

TEST(Y4mStream, TimesNeverRunAheadOfTheClock) {
  ManualClock clock;
  PipedInput pipe;
  std::string bytes = "YUV4MPEG2 W4 H3 F20:1 Cmono\n";
  for (int i = 0; i < 100; ++i) bytes += mono_frame(i);
  pipe.write(bytes);
  auto stream = open_y4m(standard_input(), clock);
  ASSERT_TRUE(stream.has_value());
  std::int64_t last_ns = -1;
  for (int i = 0; i < 100; ++i) {
    clock.advance(10'000'000);  // five times as fast as it says
    const std::int64_t time_ns = (*stream)->next(1000ms, {}).value()->time_ns;
    EXPECT_LE(time_ns, clock.now_ns());
    EXPECT_GT(time_ns, last_ns);
    last_ns = time_ns;
  }
}

TEST(Y4mStream, ARateThatIsWrongGivesWayToArrivalTimes) {
  ManualClock clock;
  PipedInput pipe;
  std::string bytes = "YUV4MPEG2 W4 H3 F30:1 Cmono\n";
  for (int i = 0; i < 100; ++i) bytes += mono_frame(i);
  pipe.write(bytes);
  auto stream = open_y4m(standard_input(), clock);
  ASSERT_TRUE(stream.has_value());
  for (int i = 0; i < 100; ++i) {
    clock.advance(66'666'667);  // half of what it says
    const std::int64_t time_ns = (*stream)->next(1000ms, {}).value()->time_ns;
    if (i > 60) {
      EXPECT_EQ(time_ns, clock.now_ns());
    }
  }
}

TEST(Y4mStream, WithoutARateTimesAreThoseOfArrivalAndRise) {
  for (const std::string& rate : {std::string(), std::string(" F0:0"), std::string(" F25:0")}) {
    ManualClock clock;
    PipedInput pipe;
    pipe.write("YUV4MPEG2 W4 H3 Cmono" + rate + "\n" + mono_frame(0) + mono_frame(1) +
               mono_frame(2));
    auto stream = open_y4m(standard_input(), clock);
    ASSERT_TRUE(stream.has_value());
    EXPECT_EQ((*stream)->settings().rate_hz, 0);
    clock.advance(500);
    EXPECT_EQ((*stream)->next(1000ms, {}).value()->time_ns, 500);
    EXPECT_EQ((*stream)->next(1000ms, {}).value()->time_ns, 501);
    clock.advance(500);
    EXPECT_EQ((*stream)->next(1000ms, {}).value()->time_ns, 1000);
  }
}

TEST(Y4mStream, GreyIsTheLumaOfEveryColourSpace) {
  struct Case {
    const char* name;
    std::size_t chroma_bytes;  // of a picture of 4 x 3
    int bits;
  };
  for (const Case& c :
       {Case{"420jpeg", 8, 8}, Case{"420mpeg2", 8, 8}, Case{"420paldv", 8, 8}, Case{"420", 8, 8},
        Case{"411", 6, 8}, Case{"422", 12, 8}, Case{"444", 24, 8}, Case{"444alpha", 36, 8},
        Case{"mono", 0, 8}, Case{"mono10", 0, 10}, Case{"mono16", 0, 16}, Case{"420p10", 16, 10},
        Case{"422p12", 24, 12}, Case{"444p16", 48, 16}}) {
    ManualClock clock;
    PipedInput pipe;
    std::string bytes = fmt::format("YUV4MPEG2 W4 H3 F20:1 C{}\n", c.name);
    for (int i = 0; i < 2; ++i) {
      bytes += "FRAME\n";
      for (const char value : luma(i)) {
        if (c.bits == 8) {
          bytes += value;
        } else {
          const int wide = (static_cast<unsigned char>(value) << (c.bits - 8)) | 1;
          bytes += static_cast<char>(wide & 255);
          bytes += static_cast<char>(wide >> 8);
        }
      }
      bytes += std::string(c.chroma_bytes, '\x55');
    }
    pipe.write(bytes);
    pipe.end();
    auto stream = open_y4m(standard_input(), clock);
    ASSERT_TRUE(stream.has_value()) << c.name << stream.error().to_string();
    for (int i = 0; i < 2; ++i) {
      const auto capture = (*stream)->next(1000ms, {});
      ASSERT_TRUE(capture.has_value() && capture->has_value()) << c.name;
      EXPECT_EQ(grey_bytes(**capture), luma(i)) << c.name;
      EXPECT_TRUE((*capture)->colour.empty());
    }
    EXPECT_FALSE((*stream)->next(1000ms, {}).value().has_value());
    EXPECT_EQ((*stream)->counts().damaged, 0u) << c.name;
  }
}

TEST(Y4mStream, ColourWhereItIsAskedFor) {
  ManualClock clock;
  PipedInput pipe;
  // BT.601, full range: Y 76, Cb 85, Cr 255 is red.
  pipe.write("YUV4MPEG2 W4 H2 F20:1 C420jpeg XCOLORRANGE=FULL\nFRAME\n" + std::string(8, '\x4C') +
             std::string(2, '\x55') + std::string(2, '\xFF'));
  auto stream = open_y4m(standard_input(true), clock);
  ASSERT_TRUE(stream.has_value());
  EXPECT_TRUE((*stream)->settings().colour);
  const auto capture = (*stream)->next(1000ms, {});
  ASSERT_TRUE(capture.has_value() && capture->has_value());
  ASSERT_EQ((*capture)->colour.width(), 4);
  const Rgb8 pixel = (*capture)->colour(2, 1);
  EXPECT_NEAR(pixel.r, 255, 2);
  EXPECT_NEAR(pixel.g, 0, 2);
  EXPECT_NEAR(pixel.b, 0, 2);
}

TEST(Y4mStream, SomethingElseBetweenFramesIsAnErrorWithItsPlace) {
  ManualClock clock;
  for (const std::string& garbage :
       {std::string("GARBAGE"), std::string("FRAMES\n"), std::string("FR\n"), std::string(64, '\0'),
        "FRAME " + std::string(2000, 'x')}) {
    PipedInput pipe;
    pipe.write(kMono + mono_frame(0) + garbage);
    auto stream = open_y4m(standard_input(), clock);
    ASSERT_TRUE(stream.has_value());
    EXPECT_TRUE((*stream)->next(1000ms, {}).value().has_value());
    const auto broken = (*stream)->next(100ms, {});
    ASSERT_FALSE(broken.has_value()) << garbage;
    EXPECT_EQ(broken.error().code, ErrorCode::io);
    EXPECT_THAT(broken.error().where, HasSubstr(fmt::format("byte {}", kMono.size() + 18)));
    EXPECT_TRUE((*stream)->ended());
  }
}

TEST(Y4mStream, SaysWhatItIsInstead) {
  using namespace std::string_literals;
  ManualClock clock;
  const std::pair<std::string, const char*> cases[] = {
      {"", "empty"},
      {"\x1A\x45\xDF\xA3 and so on", "Matroska"},
      {"\0\0\0\x18"s + "ftypisom\n", "MP4"},
      {"RIFF1234AVI LIST", "AVI"},
      {"\xFF\xD8\xFF\xE0\0\x10JFIF"s, "JPEG"},
      {"\x89PNG\r\n", "PNG"},
      {"\0\0\0\1\x67"s, "H.264"},
      {"Hello\nworld", "text (`Hello`)"},
      {"FRAME\n123", "middle of a YUV4MPEG2"},
      {"YUV4MPEG2 W4", "no end"},
      {std::string(5000, '\xAB'), "raw bytes"},
      {std::string(5000, 'y'), "text"},
      {"YUV4MPEG2 " + std::string(5000, 'X'), "no end"},
  };
  for (const auto& [bytes, said] : cases) {
    PipedInput pipe;
    pipe.write(bytes);
    pipe.end();
    const auto stream = open_y4m(standard_input(), clock);
    ASSERT_FALSE(stream.has_value()) << said;
    EXPECT_EQ(stream.error().code, ErrorCode::corrupt) << said;
    EXPECT_THAT(stream.error().to_string(), HasSubstr(said));
  }
}

TEST(Y4mStream, HeadersAreReadStrictly) {
  const std::pair<const char*, const char*> cases[] = {
      {"YUV4MPEG2", "width and height"},
      {"YUV4MPEG2 W4", "width and height"},
      {"YUV4MPEG2 W0 H3", "`W0`"},
      {"YUV4MPEG2 W-4 H3", "`W-4`"},
      {"YUV4MPEG2 W4x H3", "`W4x`"},
      {"YUV4MPEG2 W99999999999999999999 H3", "`W99999999999999999999`"},
      {"YUV4MPEG2 W1000000000 H1000000000", "16384 px at most"},
      {"YUV4MPEG2 W4 H20000", "16384 px at most"},
      {"YUV4MPEG2 W4 H3 F30", "`F30`"},
      {"YUV4MPEG2 W4 H3 F-1:1", "`F-1:1`"},
      {"YUV4MPEG2 W4 H3 F1:1000000000", "0.001"},
      {"YUV4MPEG2 W4 H3 F1000000000:1", "1e6"},
      {"YUV4MPEG2 W4 H3 It", "interlaced"},
      {"YUV4MPEG2 W4 H3 Iq", "`Iq`"},
      {"YUV4MPEG2 W4 H3 A1", "`A1`"},
      {"YUV4MPEG2 W4 H3 C410", "410 is not known"},
      {"YUV4MPEG2 W4 H3 C420p17", "420p17"},
      {"YUV4MPEG2 W4 H3 C422jpeg", "422jpeg"},
      {"YUV4MPEG2 W4 H3 Cmono8", "mono8"},
      {"YUV4MPEG2 W4 H3 Z1", "`Z1`"},
      {"YUV4MPEG W4 H3", "looks like"},
  };
  for (const auto& [line, said] : cases) {
    const auto header = parse_y4m_header(line, "pipe");
    ASSERT_FALSE(header.has_value()) << line;
    EXPECT_THAT(header.error().to_string(), HasSubstr(said)) << line;
  }
  const auto good = parse_y4m_header("YUV4MPEG2 W5 H3 F25:1 I? A0:0 C420p10 XYSCSS=420P10", "pipe");
  ASSERT_TRUE(good.has_value()) << good.error().to_string();
  EXPECT_EQ(good->frame_bytes(), 2u * (15 + 2 * 6));
  EXPECT_TRUE(good->unknown_order);
}

TEST(Y4mStream, WhatCannotBeOpenedSaysSo) {
  ManualClock clock;
  const TempFolder folder;
  CameraRequest request;
  request.device = folder / "absent";
  EXPECT_EQ(open_y4m(request, clock).error().code, ErrorCode::not_found);
  request.device = folder.path();
  EXPECT_EQ(open_y4m(request, clock).error().code, ErrorCode::invalid_argument);
  test::write_text(folder / "file.y4m", kMono + mono_frame(0));
  request.device = folder / "file.y4m";
  EXPECT_THAT(open_y4m(request, clock).error().to_string(), HasSubstr("corvid replay"));
  // What a pipe cannot be asked for is said.
  PipedInput pipe;
  pipe.write(kMono + mono_frame(0));
  request = standard_input();
  request.width_px = 640;
  const auto stream = open_y4m(request, clock);
  ASSERT_TRUE(stream.has_value()) << stream.error().to_string();
  EXPECT_THAT((*stream)->settings().notes, testing::Contains(HasSubstr("cannot be asked")));
}

}  // namespace
}  // namespace corvid
