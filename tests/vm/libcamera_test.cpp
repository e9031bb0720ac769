#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <sys/mount.h>

#include <cmath>
#include <optional>
#include <stop_token>

#include "core/clock.h"
#include "io/camera/libcamera_camera.h"
#include "scenes/folder_entries.h"
#include "vm/emulated_camera.h"
#include "vm/numbered_picture.h"
#include "vm/stream_checks.h"

namespace corvid::vm {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

const char* const kVimc = "platform/vimc.0 Sensor B";

/// libcamera names a UVC camera after the first parent that firmware describes, and passes over one
/// that has none. The emulated ones hang below a platform device without: this gives it one.
/// libudev takes only true sysfs, so the buses are put back on top of the overlay.
void describe_usb_in_firmware() {
  const fs::path device = "/sys/devices/platform/vhci_hcd.0";
  const fs::path added = "/run/firmware/added", real = "/run/firmware/real";
  fs::create_directories(added / "firmware_node");
  fs::create_directories(real);
  std::ofstream(added / "firmware_node" / "path") << "\\_SB_.VHCI\n";
  const auto bind = [](const fs::path& from, const fs::path& to) {
    ASSERT_EQ(::mount(from.c_str(), to.c_str(), nullptr, MS_BIND, nullptr), 0) << to;
  };
  bind(device, real);
  const std::string layers = "lowerdir=" + added.string() + ":" + real.string();
  ASSERT_EQ(::mount("overlay", device.c_str(), "overlay", MS_RDONLY, layers.c_str()), 0);
  for (const auto& entry : fs::directory_iterator(real)) {
    const std::string name = entry.path().filename();
    const bool writable = name == "attach" || name == "detach";
    if (writable || name.starts_with("usb")) bind(entry.path(), device / name);
  }
}

std::string uvc_id(int port) {
  return "\\_SB_.VHCI-" + std::to_string(port + 1) + ":1.0-1d6b:0102";
}

/// The listing of a camera, once udev has announced it and it can be used.
std::optional<CameraListing> listed(const std::string& id) {
  std::optional<CameraListing> found;
  EXPECT_TRUE(eventually([&] {
    for (CameraListing& listing : list_libcamera_cameras()) {
      if (listing.id == "libcamera:" + id && listing.problem.empty()) found = std::move(listing);
    }
    return found.has_value();
  })) << id;
  return found;
}

class Libcamera : public GuestTest {
 protected:
  static void SetUpTestSuite() {
    if (in_guest()) describe_usb_in_firmware();
  }
  std::unique_ptr<CameraStream> open(const CameraRequest& request) {
    auto stream = open_libcamera(request, clock_);
    if (stream) return std::move(*stream);
    ADD_FAILURE() << stream.error().to_string();
    return nullptr;
  }
  /// The next picture; an empty one, and a failure, if there is none.
  static Capture next(CameraStream& stream) {
    const auto capture = stream.next(kPatience, {});
    if (capture && *capture) return **capture;
    ADD_FAILURE() << (capture ? "no picture" : capture.error().to_string());
    return Capture{.grey = GreyImage(256, 16), .colour = {}};
  }
  /// The number in a picture of the emulated camera, all of whose pixels are checked.
  static std::uint32_t checked_number(const GreyImage& grey) {
    const std::uint32_t number = number_in(grey.data(), grey.width());
    const std::vector<std::uint8_t> sent = numbered_picture(grey.width(), grey.height(), number);
    EXPECT_TRUE(std::equal(sent.begin(), sent.end(), grey.data())) << "picture " << number;
    return number;
  }
  SteadyClock clock_;
};

TEST_F(Libcamera, ListsCamerasWithTheirModes) {
  const EmulatedCamera camera;
  const auto uvc = listed(uvc_id(0)), vimc = listed(kVimc);
  ASSERT_TRUE(uvc && vimc);
  const auto has = [](const CameraListing& listing, const char* format, int width_px,
                      int height_px) {
    return std::any_of(listing.modes.begin(), listing.modes.end(), [&](const CameraMode& mode) {
      return mode.format == format && mode.width_px == width_px && mode.height_px == height_px;
    });
  };
  EXPECT_EQ(uvc->driver, "uvcvideo");
  EXPECT_NE(uvc->name.find("Test UVC Camera"), std::string::npos) << uvc->name;
  EXPECT_EQ(uvc->modes.size(), 9U);
  for (const char* format : {"R8", "YUYV", "MJPEG"}) {
    EXPECT_TRUE(has(*uvc, format, 320, 240)) << format;
    EXPECT_TRUE(has(*uvc, format, 640, 480)) << format;
    EXPECT_TRUE(has(*uvc, format, 1280, 720)) << format;
  }
  ASSERT_EQ(vimc->modes.size(), 2U);
  EXPECT_TRUE(has(*vimc, "RGB888", 4096, 2160));
  EXPECT_TRUE(has(*vimc, "BGR888", 4096, 2160));
  EXPECT_EQ(vimc->modes[0].note, "sizes from 48 x 48 on");
}

TEST_F(Libcamera, UvcPicturesComeWholeNumberedAndTimed) {
  const EmulatedCamera camera;
  ASSERT_TRUE(listed(uvc_id(0)));
  const auto stream = open(request_of(uvc_id(0), "", 640, 480));
  ASSERT_TRUE(stream);
  EXPECT_EQ(stream->settings().format, "R8") << "the best for grey";
  EXPECT_EQ(stream->settings().width_px, 640);
  EXPECT_EQ(stream->settings().height_px, 480);
  EXPECT_EQ(stream->settings().rate_hz, 0) << "libcamera does not know";
  const std::uint32_t first = checked_number(next(*stream).grey);
  std::int64_t before_ns = 0;
  std::uint64_t sequence = 0;
  std::uint32_t number = first;
  for (int i = 1; i < 25; ++i) {
    // What is not fetched in time is lost, and counted.
    if (i == 10) std::this_thread::sleep_for(milliseconds(1000));
    const Capture capture = next(*stream);
    number = checked_number(capture.grey);
    EXPECT_EQ(number - first, capture.sequence) << "the camera numbers as the driver does";
    EXPECT_GT(capture.sequence, sequence);
    EXPECT_GT(capture.time_ns, before_ns);
    const double age_s = difference_s(clock_.now_ns(), capture.time_ns);
    EXPECT_GT(age_s, 0);
    EXPECT_LT(age_s, 5);
    EXPECT_TRUE(capture.colour.empty());
    sequence = capture.sequence;
    before_ns = capture.time_ns;
  }
  const StreamCounts counts = stream->counts();
  EXPECT_GT(counts.lost, 0U);
  EXPECT_EQ(25 + counts.lost + counts.damaged, number - first + 1);
  EXPECT_TRUE(stream->settings().notes.empty()) << stream->settings().notes[0];
}

TEST_F(Libcamera, UvcFormatsShowTheSamePicture) {
  const EmulatedCamera camera;
  ASSERT_TRUE(listed(uvc_id(0)));
  CameraRequest request = request_of(uvc_id(0), "", 320, 240);
  request.colour = true;
  {
    const auto stream = open(request);
    ASSERT_TRUE(stream);
    EXPECT_EQ(stream->settings().format, "YUYV") << "the best with colour";
    const Capture capture = next(*stream);
    checked_number(capture.grey);
    ASSERT_EQ(capture.colour.width(), 320);
    const Rgb8 pixel = capture.colour(100, 100);
    EXPECT_EQ(pixel.r, pixel.g);
    EXPECT_EQ(pixel.g, pixel.b);
  }
  request.format = "MJPEG";
  const auto stream = open(request);
  ASSERT_TRUE(stream);
  const GreyImage grey = next(*stream).grey;
  const std::uint32_t number = number_in(grey.data(), grey.width());
  int worst = 0;
  for (int y = kBit_px; y < 240; ++y) {
    for (int x = 0; x < 320; ++x) {
      worst = std::max(worst, std::abs(grey(x, y) - numbered_luma(x, y, number)));
    }
  }
  EXPECT_LE(worst, 12) << "but for what JPEG does";
}

TEST_F(Libcamera, FaultyPicturesAreCountedAndPassedOver) {
  EmulatedCamera camera;
  ASSERT_TRUE(listed(uvc_id(0)));
  const auto stream = open(request_of(uvc_id(0), "R8", 320, 240));
  ASSERT_TRUE(stream);
  for (const char* command : {"fault", "cut"}) {
    const std::uint64_t before = stream->counts().damaged;
    // A slow machine may lose the very picture.
    EXPECT_TRUE(eventually([&] {
      camera.command(command);
      checked_number(next(*stream).grey);
      return stream->counts().damaged > before;
    })) << command;
  }
  EXPECT_EQ(stream->counts().messages.size(), stream->counts().damaged);
}

TEST_F(Libcamera, ExposureAndGainReachTheCamera) {
  const EmulatedCamera camera;
  ASSERT_TRUE(listed(uvc_id(0)));
  CameraRequest request = request_of(uvc_id(0), "R8", 320, 240);
  request.rate_hz = 30;
  request.exposure_s = 0.01;
  request.gain = 2;
  const auto value_of = [&](std::uint32_t id) {
    const int fd = ::open(camera.node().c_str(), O_RDWR | O_CLOEXEC);
    v4l2_control control{.id = id, .value = -1};
    EXPECT_EQ(::ioctl(fd, VIDIOC_G_CTRL, &control), 0);
    ::close(fd);
    return control.value;
  };
  {
    const auto stream = open(request);
    ASSERT_TRUE(stream);
    EXPECT_EQ(
        stream->settings().notes,
        std::vector<std::string>{"libcamera cannot set this camera's rate; 30 Hz was asked for."});
    for (int i = 0; i < 3; ++i) next(*stream);
    EXPECT_EQ(value_of(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_MANUAL);
    EXPECT_EQ(value_of(V4L2_CID_EXPOSURE_ABSOLUTE), 100) << "[100 us]";
    // libcamera puts 1 at the camera's usual gain (10) and 4 at its most (100).
    EXPECT_EQ(value_of(V4L2_CID_GAIN), 40);
    EXPECT_EQ(stream->settings().notes.size(), 1U);
  }
  request.rate_hz = 0;
  request.exposure_s = 1000;
  request.gain = 0.001;
  const auto stream = open(request);
  ASSERT_TRUE(stream);
  ASSERT_EQ(stream->settings().notes.size(), 2U);
  EXPECT_EQ(stream->settings().notes[0],
            "The exposure 1000 s is outside of the camera's 0.0001 to 1 s; 1 s was taken.");
  for (int i = 0; i < 3; ++i) next(*stream);
  EXPECT_EQ(value_of(V4L2_CID_EXPOSURE_ABSOLUTE), 10000);
  EXPECT_EQ(value_of(V4L2_CID_GAIN), 0);
}

TEST_F(Libcamera, VimcShowsItsColourBarsInBothOrdersOfBytes) {
  ASSERT_TRUE(listed(kVimc));
  // 75% bars. vimc's debayering mixes neighbours of yellow, cyan and green too dark.
  const std::vector<Rgb8> bars = {{191, 191, 191}, {191, 143, 0}, {0, 114, 95}, {0, 114, 0},
                                  {191, 0, 191},   {191, 0, 0},   {0, 0, 191},  {0, 0, 0}};
  for (const char* format : {"RGB888", "BGR888"}) {
    CameraRequest request = request_of(kVimc, format, 640, 480);
    request.colour = true;
    request.exposure_s = 0.01;
    const auto stream = open(request);
    ASSERT_TRUE(stream);
    EXPECT_EQ(stream->settings().notes,
              (std::vector<std::string>{
                  "The camera took 636 x 480 pixels instead of 640 x 480.",
                  "libcamera cannot set this camera's exposure; it is left as it is."}));
    std::int64_t before_ns = 0;
    for (int i = 0; i < 5; ++i) {
      const Capture capture = next(*stream);
      const double age_s = difference_s(clock_.now_ns(), capture.time_ns);
      EXPECT_TRUE(capture.time_ns > before_ns && age_s > 0 && age_s < 5) << age_s;
      before_ns = capture.time_ns;
      ASSERT_EQ(capture.colour.width(), 636);
      for (std::size_t bar = 0; bar < bars.size(); ++bar) {
        const int x = 636 * (2 * static_cast<int>(bar) + 1) / 16;
        const Rgb8 seen = capture.colour(x, 240), wanted = bars[bar];
        EXPECT_EQ(seen, wanted) << format << " bar " << bar << ": " << int{seen.r} << " "
                                << int{seen.g} << " " << int{seen.b};
        const double luma = 0.299 * wanted.r + 0.587 * wanted.g + 0.114 * wanted.b;
        EXPECT_NEAR(capture.grey(x, 240), luma, 1) << format << " bar " << bar;
      }
    }
  }
}

TEST_F(Libcamera, ThreeCamerasAtOnce) {
  const EmulatedCamera one(0), two(1);
  ASSERT_TRUE(listed(uvc_id(0)) && listed(uvc_id(1)) && listed(kVimc));
  std::vector<std::unique_ptr<CameraStream>> streams;
  streams.push_back(open(request_of(uvc_id(0), "R8", 320, 240)));
  streams.push_back(open(request_of(uvc_id(1), "YUYV", 640, 480)));
  streams.push_back(open(request_of(kVimc, "BGR888", 240, 240)));
  ASSERT_TRUE(streams[0] && streams[1] && streams[2]);
  for (int i = 0; i < 10; ++i) {
    checked_number(next(*streams[0]).grey);
    checked_number(next(*streams[1]).grey);
    EXPECT_EQ(next(*streams[2]).grey(10, 120), 191);
  }
  // To list them meanwhile disturbs none, and says so.
  int in_use = 0;
  for (const CameraListing& listing : list_libcamera_cameras()) {
    in_use += listing.problem == "in use";
    EXPECT_FALSE(listing.modes.empty()) << listing.id;
  }
  EXPECT_EQ(in_use, 3);
  const auto again = open_libcamera(request_of(uvc_id(0)), clock_);
  ASSERT_FALSE(again);
  EXPECT_EQ(again.error().code, ErrorCode::io);
  EXPECT_EQ(again.error().what, "the camera is in use");
  for (const auto& stream : streams) next(*stream);
}

TEST_F(Libcamera, RefusesWhatIsNotThere) {
  const EmulatedCamera camera;
  ASSERT_TRUE(listed(uvc_id(0)));
  const auto unknown = open_libcamera(request_of("platform/vimc.0 Sensor A"), clock_);
  ASSERT_FALSE(unknown);
  EXPECT_EQ(unknown.error().code, ErrorCode::not_found);
  EXPECT_EQ(unknown.error().hint, "did you mean platform/vimc.0 Sensor B? there are: " + uvc_id(0) +
                                      ", platform/vimc.0 Sensor B");
  const auto format = open_libcamera(request_of(uvc_id(0), "YUVY"), clock_);
  ASSERT_FALSE(format);
  EXPECT_EQ(format.error().code, ErrorCode::unsupported);
  CameraRequest request = request_of(uvc_id(0), "", 640, 0);
  EXPECT_EQ(open_libcamera(request, clock_).error().code, ErrorCode::invalid_argument);
  request = request_of(uvc_id(0));
  request.exposure_s = std::nan("");
  EXPECT_EQ(open_libcamera(request, clock_).error().code, ErrorCode::invalid_argument);
  // What was refused leaves the camera free.
  const auto stream = open(request_of(uvc_id(0), "YUYV"));
  ASSERT_TRUE(stream);
  next(*stream);
}

TEST_F(Libcamera, UnpluggedInMidStreamEndsAndComesBack) {
  std::optional<EmulatedCamera> camera(std::in_place, 0);
  const EmulatedCamera other(1);
  ASSERT_TRUE(listed(uvc_id(1)));
  const auto bystander = open(request_of(uvc_id(1), "R8", 320, 240));
  ASSERT_TRUE(bystander);
  for (int round = 0; round < 3; ++round) {
    ASSERT_TRUE(listed(uvc_id(0)));
    const auto stream = open(request_of(uvc_id(0), "R8", 320, 240));
    ASSERT_TRUE(stream);
    for (int i = 0; i < 3; ++i) checked_number(next(*stream).grey);
    // A reader that waits for a picture, one that comes when all is over, and one that was late and
    // has all of the requests.
    if (round == 2) std::this_thread::sleep_for(milliseconds(500));
    std::jthread unplugging([&] { camera->unplug(); });
    if (round == 1) unplugging.join();
    std::optional<Error> error;
    const bool ended = eventually([&] {
      const auto capture = stream->next(kPatience, {});
      EXPECT_TRUE(!capture || *capture) << "it waited in vain";
      if (!capture) error = capture.error();
      return !capture;
    });
    ASSERT_TRUE(ended);
    EXPECT_EQ(error->code, ErrorCode::io);
    EXPECT_EQ(error->what, "the camera was unplugged");
    EXPECT_FALSE(stream->next(milliseconds(0), {})) << "it stays over";
    checked_number(next(*bystander).grey);
    if (unplugging.joinable()) unplugging.join();
    camera.emplace(0);
  }
}

// The device is gone, and nobody has noticed yet. (In the microseconds in which it goes, libcamera
// 0.0.3 ends the process: docs/decisions/libcamera.md.)
TEST_F(Libcamera, ClosesAfterItWasUnpluggedUnnoticed) {
  for (int round = 0; round < 4; ++round) {
    EmulatedCamera camera;
    ASSERT_TRUE(listed(uvc_id(0)));
    auto stream = open(request_of(uvc_id(0), "R8", 320, 240));
    ASSERT_TRUE(stream);
    next(*stream);
    camera.unplug();
    stream.reset();
  }
}

TEST_F(Libcamera, ManyOpeningsLeaveNothingBehind) {
  const EmulatedCamera one(0), two(1);
  ASSERT_TRUE(listed(uvc_id(0)) && listed(uvc_id(1)));
  // First with libcamera's manager starting and ending each time, then while another holds it.
  for (const int cycles : {4, 40}) {
    const auto other = cycles == 4 ? nullptr : open(request_of(uvc_id(1), "R8", 320, 240));
    const std::size_t files = entries_of("/proc/self/fd"), threads = entries_of("/proc/self/task");
    for (int i = 0; i < cycles; ++i) {
      const auto stream = open(request_of(uvc_id(0), "R8", 320, 240));
      ASSERT_TRUE(stream);
      // Ended at once, after a picture, and with some pictures waiting.
      if (i % 8 == 1) next(*stream);
      if (i % 8 == 2) std::this_thread::sleep_for(milliseconds(100));
    }
    EXPECT_EQ(entries_of("/proc/self/fd"), files) << cycles;
    EXPECT_EQ(entries_of("/proc/self/task"), threads) << cycles;
  }
}

TEST_F(Libcamera, NextAnswersWhenAskedToStopAndWhenNothingComes) {
  EmulatedCamera camera;
  ASSERT_TRUE(listed(uvc_id(0)));
  const auto stream = open(request_of(uvc_id(0), "R8", 320, 240));
  ASSERT_TRUE(stream);
  next(*stream);
  camera.command("pause");
  bool came = true;  // what was under way
  for (int i = 0; i < 100 && came; ++i) {
    const auto capture = stream->next(milliseconds(200), {});
    ASSERT_TRUE(capture) << capture.error().to_string();
    came = capture->has_value();
  }
  EXPECT_FALSE(came);
  std::stop_source stop;
  const std::jthread stopping([&] { stop.request_stop(); });
  const auto stopped = stream->next(std::chrono::milliseconds::max(), stop.get_token());
  ASSERT_TRUE(stopped);
  EXPECT_FALSE(*stopped);
  camera.command("resume");
  checked_number(next(*stream).grey);
}

}  // namespace
}  // namespace corvid::vm
