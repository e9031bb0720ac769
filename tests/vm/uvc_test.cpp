#include <gmock/gmock.h>

#include <cstdlib>
#include <fstream>
#include <stop_token>
#include <thread>

#include "vm/emulated_camera.h"
#include "vm/numbered_picture.h"
#include "vm/stream_checks.h"
#include "vm/v4l2_controls.h"

namespace corvid::vm {
namespace {

using testing::HasSubstr;

class Uvc : public GuestTest {
 protected:
  void TearDown() override { set_nodrop(false); }

  /// Whether uvcvideo hands on the pictures that it knows to be faulty.
  static void set_nodrop(bool nodrop) {
    if (in_guest()) std::ofstream("/sys/module/uvcvideo/parameters/nodrop") << (nodrop ? 1 : 0);
  }
};

std::uint32_t number_of(const Capture& capture) {
  return number_in(capture.grey.data(), capture.grey.width());
}

/// The largest difference from the picture with this number.
int largest_error(const GreyImage& grey, std::uint32_t number) {
  int largest = 0;
  for (int y = 0; y < grey.height(); ++y) {
    for (int x = 0; x < grey.width(); ++x) {
      largest = std::max(largest, std::abs(grey(x, y) - numbered_luma(x, y, number)));
    }
  }
  return largest;
}

TEST_F(Uvc, EveryFormatAndSizeDeliversThePicturesThatWereSent) {
  const EmulatedCamera camera;
  struct Mode {
    std::string format;
    int width_px, height_px;
  };
  for (const auto& [format, width_px, height_px] :
       {Mode{"GREY", 320, 240}, Mode{"GREY", 640, 480}, Mode{"GREY", 1280, 720},
        Mode{"YUYV", 640, 480}, Mode{"MJPG", 320, 240}, Mode{"MJPG", 640, 480}}) {
    SCOPED_TRACE(format + " " + std::to_string(width_px));
    const auto stream = opened(request_of(camera.node(), format, width_px, height_px));
    ASSERT_TRUE(stream);
    EXPECT_EQ(stream->settings().format, format);
    EXPECT_EQ(stream->settings().notes, std::vector<std::string>());
    for (int i = 0; i < 2; ++i) {
      const Capture capture = taken(*stream);
      ASSERT_EQ(capture.grey.width(), width_px);
      ASSERT_EQ(capture.grey.height(), height_px);
      EXPECT_LE(largest_error(capture.grey, number_of(capture)), format == "MJPG" ? 24 : 0);
    }
  }
}

TEST_F(Uvc, GreyIsChosenWhereNoFormatIsAskedFor) {
  const EmulatedCamera camera;
  const auto stream = opened(request_of(camera.node()));
  ASSERT_TRUE(stream);
  EXPECT_EQ(stream->settings().format, "GREY");
  EXPECT_EQ(stream->settings().width_px, 640);
  EXPECT_NEAR(stream->settings().rate_hz, 30, 0.01);
}

TEST_F(Uvc, PicturesArriveOnceInOrderAndWhatAPauseCostIsCounted) {
  EmulatedCamera camera;
  const auto stream = opened(request_of(camera.node(), "GREY", 320, 240, 60));
  ASSERT_TRUE(stream);
  const Capture first = taken(*stream);
  Capture last = first;
  std::uint64_t missing = 0;
  for (int i = 0; i < 60; ++i) {
    if (i == 20) {  // a pause that no number of buffers outlasts
      const std::uint32_t now = camera.command("count");
      ASSERT_TRUE(eventually([&] { return camera.command("count") > now + 30; }));
    }
    Capture capture = taken(*stream);
    ASSERT_GT(number_of(capture), number_of(last));
    EXPECT_EQ(capture.sequence - last.sequence, number_of(capture) - number_of(last));
    EXPECT_GT(capture.time_ns, last.time_ns);
    EXPECT_LE(capture.time_ns, steady_clock().now_ns());
    missing += number_of(capture) - number_of(last) - 1;
    last = std::move(capture);
  }
  EXPECT_GT(missing, 0u);
  EXPECT_EQ(stream->counts().lost, missing);
  EXPECT_EQ(stream->counts().damaged, 0u);
}

TEST_F(Uvc, ACutOffJpegIsDamaged) {
  EmulatedCamera camera;
  const auto stream = opened(request_of(camera.node(), "MJPG", 320, 240));
  ASSERT_TRUE(stream);
  taken(*stream);
  const std::uint32_t cut = camera.command("cut");
  for (std::uint32_t number = 0; number <= cut; number = number_of(taken(*stream))) {
    ASSERT_FALSE(HasFailure());
  }
  ASSERT_EQ(stream->counts().damaged, 1u);
  EXPECT_THAT(stream->counts().messages.at(0), HasSubstr("cut-off"));
}

// By itself uvcvideo drops what it knows to be faulty: only the numbers tell.
TEST_F(Uvc, FaultyPicturesAreLostOrDamagedAsTheDriverIsSetUp) {
  for (const bool nodrop : {false, true}) {
    SCOPED_TRACE(nodrop);
    set_nodrop(nodrop);  // what it does with a camera is settled when that is plugged in
    EmulatedCamera camera;
    const auto stream = opened(request_of(camera.node(), "GREY", 320, 240, 15));
    ASSERT_TRUE(stream);
    for (const std::string command : {"fault", "cut"}) {
      taken(*stream);
      const std::uint32_t bad = camera.command(command);
      for (std::uint32_t number = 0; number <= bad; number = number_of(taken(*stream))) {
        ASSERT_FALSE(HasFailure());
      }
    }
    if (nodrop) {
      ASSERT_EQ(stream->counts().damaged, 2u);
      EXPECT_THAT(stream->counts().messages.at(0), HasSubstr("faulty"));
    } else {
      EXPECT_GE(stream->counts().lost, 2u);
      EXPECT_EQ(stream->counts().damaged, 0u);
    }
  }
}

TEST_F(Uvc, UnpluggedInMidStreamAndPluggedInAgain) {
  std::string node;
  {
    EmulatedCamera camera;
    node = camera.node();
    const auto stream = opened(request_of(node, "GREY", 320, 240));
    ASSERT_TRUE(stream);
    taken(*stream);
    std::jthread unplugs([&] { camera.unplug(); });
    const Error end = end_of(*stream);
    EXPECT_EQ(end.code, ErrorCode::io);
    EXPECT_THAT(end.to_string(), HasSubstr(node + ": the camera is gone"));
    EXPECT_FALSE(stream->next(kPatience, {}).has_value());
  }
  EXPECT_FALSE(listing_of(node));
  EXPECT_EQ(refused(request_of(node)).code, ErrorCode::not_found);
  const EmulatedCamera again;
  const auto stream = opened(request_of(again.node(), "YUYV", 320, 240));
  ASSERT_TRUE(stream);
  EXPECT_EQ(largest_error(taken(*stream).grey, 0), 0);
}

TEST_F(Uvc, TwoCamerasAtOnce) {
  const EmulatedCamera left(0), right(1);
  ASSERT_NE(left.node(), right.node());
  const auto a = opened(request_of(left.node(), "GREY", 320, 240));
  const auto b = opened(request_of(right.node(), "YUYV", 640, 480));
  ASSERT_TRUE(a && b);
  for (std::uint64_t i = 0; i < 10; ++i) {
    const Capture from_a = taken(*a), from_b = taken(*b);
    EXPECT_EQ(largest_error(from_a.grey, number_of(from_a)), 0);
    EXPECT_EQ(largest_error(from_b.grey, number_of(from_b)), 0);
    EXPECT_EQ(from_b.grey.width(), 640);
  }
}

TEST_F(Uvc, ACameraThatStallsGivesNothingUntilItGoesOn) {
  EmulatedCamera camera;
  const auto stream = opened(request_of(camera.node(), "GREY", 320, 240));
  ASSERT_TRUE(stream);
  taken(*stream);
  camera.command("pause");
  bool stalled = false;
  for (int i = 0; i < 100 && !stalled; ++i) {
    const auto picture = stream->next(std::chrono::milliseconds(200), {});
    ASSERT_TRUE(picture.has_value());
    stalled = !picture->has_value();
  }
  EXPECT_TRUE(stalled);
  // Asked to stop, the wait ends long before its time.
  std::stop_source stop;
  std::jthread asks([&] { stop.request_stop(); });
  const auto nothing = stream->next(std::chrono::hours(1), stop.get_token());
  EXPECT_TRUE(nothing.has_value() && !nothing->has_value());
  const std::uint32_t next = camera.command("resume");
  EXPECT_EQ(number_of(taken(*stream)), next);
}

TEST_F(Uvc, ExposureAndGainAreSetAndReadBack) {
  const EmulatedCamera camera;
  const ControlPanel panel(camera.node());
  CameraRequest request = request_of(camera.node(), "GREY", 320, 240);
  request.exposure_s = 0.005;
  request.gain = 42;
  {
    const auto stream = opened(request);
    ASSERT_TRUE(stream);
    EXPECT_EQ(notes_of(*stream), "");
    EXPECT_EQ(panel.value("Auto Exposure"), V4L2_EXPOSURE_MANUAL);
    EXPECT_EQ(panel.value("Exposure Time, Absolute"), 50);
    EXPECT_EQ(panel.value("Gain"), 42);
  }
  request.exposure_s = 30;  // the camera ends at 1 s
  request.gain = -1e300;
  const auto stream = opened(request);
  ASSERT_TRUE(stream);
  EXPECT_EQ(panel.value("Exposure Time, Absolute"), 10'000);
  EXPECT_EQ(panel.value("Gain"), 0);
  EXPECT_THAT(notes_of(*stream), HasSubstr("exposure 30 s was asked for, the camera is at 1 s"));
  EXPECT_THAT(notes_of(*stream), HasSubstr("the camera is at 0 (its range: 0 to 100)"));
}

TEST_F(Uvc, TheNearestRateAndSizeAreSetAndTheDifferenceIsTold) {
  const EmulatedCamera camera;
  {
    const auto stream = opened(request_of(camera.node(), "GREY", 320, 240, 15));
    ASSERT_TRUE(stream);
    EXPECT_NEAR(stream->settings().rate_hz, 15, 0.001);
    EXPECT_EQ(notes_of(*stream), "");
  }
  const auto stream = opened(request_of(camera.node(), "YUYV", 700, 500, 29.97));
  ASSERT_TRUE(stream);
  EXPECT_EQ(stream->settings().width_px, 640);
  EXPECT_EQ(taken(*stream).grey.width(), 640);
  EXPECT_THAT(notes_of(*stream),
              HasSubstr("700 x 500 pixels were asked for, the camera gives 640 x 480"));
  EXPECT_THAT(notes_of(*stream), HasSubstr("29.97 Hz were asked for, the camera gives 30 Hz"));
}

TEST_F(Uvc, ListedWithItsModesWithoutItsMetadataAndInUse) {
  const EmulatedCamera camera;
  auto listing = listing_of(camera.node());
  ASSERT_TRUE(listing);
  EXPECT_THAT(listing->name, HasSubstr("Test UVC Camera"));
  EXPECT_EQ(listing->driver, "uvcvideo");
  EXPECT_EQ(listing->problem, "");
  ASSERT_EQ(listing->modes.size(), 9u);
  EXPECT_EQ(listing->modes[0].format, "GREY");
  EXPECT_EQ(listing->modes[0].width_px, 640);
  ASSERT_EQ(listing->modes[0].rates_hz.size(), 3u);
  EXPECT_NEAR(listing->modes[0].rates_hz[0], 60, 0.01);
  EXPECT_NEAR(listing->modes[0].rates_hz[2], 15, 0.01);
  EXPECT_EQ(list_v4l2_cameras().size(), 1u);  // and not the node of its metadata

  const auto stream = opened(request_of(camera.node(), "GREY", 320, 240));
  ASSERT_TRUE(stream);
  taken(*stream);
  listing = listing_of(camera.node());
  ASSERT_TRUE(listing);
  EXPECT_THAT(listing->problem, HasSubstr("in use by another program"));
  taken(*stream);  // looking at it did it no harm
  const Error busy = refused(request_of(camera.node(), "YUYV", 640, 480));
  EXPECT_EQ(busy.code, ErrorCode::io);
  EXPECT_THAT(busy.to_string(), HasSubstr(camera.node() + ": the camera is in use"));
}

TEST_F(Uvc, WhatIsNoCameraIsRefusedWithThoseThatAre) {
  const EmulatedCamera camera;
  const Error missing = refused(request_of("/dev/video99"));
  EXPECT_EQ(missing.code, ErrorCode::not_found);
  EXPECT_THAT(missing.hint, HasSubstr(camera.node() + " (Test UVC Camera"));
  EXPECT_THAT(refused(request_of("/dev/null")).what, HasSubstr("no V4L2 device"));
  const Error format = refused(request_of(camera.node(), "NV12"));
  EXPECT_EQ(format.code, ErrorCode::unsupported);
  EXPECT_THAT(format.to_string(), HasSubstr("no format NV12"));
  EXPECT_THAT(format.hint, HasSubstr("it has: GREY, YUYV, MJPG"));
  std::string metadata;
  for (const auto& entry : std::filesystem::directory_iterator("/sys/class/video4linux")) {
    if (first_line(entry.path() / "index") == "1") metadata = entry.path().filename();
  }
  ASSERT_NE(metadata, "");
  EXPECT_THAT(refused(request_of("/dev/" + metadata)).what, HasSubstr("does not capture"));
}

}  // namespace
}  // namespace corvid::vm
