#include <gmock/gmock.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "core/alignment.h"
#include "io/source.h"
#include "io/trajectory_file.h"
#include "vm/corvid_program.h"
#include "vm/emulated_camera.h"
#include "vm/loopback_writer.h"
#include "vm/numbered_picture.h"

namespace corvid::vm {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::HasSubstr;

class Live : public GuestTest {
 protected:
  void TearDown() override { fs::remove_all(folder_); }

  [[nodiscard]] std::string path(const std::string& name) const {
    return (folder_ / name).string();
  }
  [[nodiscard]] std::vector<std::string> arguments(const std::string& camera) const {
    return {"--quiet",   "live",         "--camera", "v4l2:" + camera,          "--out",
            path("run"), "--no-mapping", "--set",    "frontend.max_tracks=120", "--json"};
  }
  /// The saved run.json; nothing besides the run's folder is left.
  [[nodiscard]] json saved_run() const {
    for (const auto& entry : fs::directory_iterator(folder_)) {
      EXPECT_EQ(entry.path().filename(), "run");
    }
    std::ifstream file(path("run/run.json"));
    return json::parse(file, nullptr, false);
  }

  const fs::path folder_ = [] {
    std::string name = (fs::temp_directory_path() / "live.XXXXXX").string();
    return fs::path(::mkdtemp(name.data()));
  }();
};

struct Flight {
  std::vector<FramePtr> frames;
  Trajectory truth;
  std::string calibration;
};

/// What engine.sh has recorded.
Flight recorded_flight() {
  Flight flight;
  const char* folder = std::getenv("CORVID_FLIGHT");
  if (folder == nullptr) return flight;
  flight.calibration = std::string(folder) + "/mav0/cam0/sensor.yaml";
  const auto source = open_source(folder);
  if (!source) return flight;
  for (auto frame = (*source)->next(); frame && *frame; frame = (*source)->next()) {
    flight.frames.push_back(*frame);
  }
  flight.truth = (*source)->truth();
  return flight;
}

// The next picture is written when the last one has its pose: the guest's speed does not count.
TEST_F(Live, AFlightThroughALoopbackDeviceGivesItsTrajectory) {
  const Flight flight = recorded_flight();
  ASSERT_GE(flight.frames.size(), 20u);
  ASSERT_EQ(flight.truth.size(), flight.frames.size());
  ASSERT_EQ(video_nodes("Loopback").size(), 1u);
  const std::string node = video_nodes("Loopback")[0];
  const GreyImage& first = flight.frames[0]->grey;
  constexpr unsigned kInterval_s = 10;  // ten times this without a picture would be a stall
  const LoopbackWriter writer(node, first.width(), first.height(), kInterval_s);
  const auto write = [&writer](const GreyImage& grey) {
    return writer.write(grey.data(), grey.size());
  };
  ASSERT_TRUE(write(first));

  auto words = arguments(node);
  words.insert(words.end(), {"--calibration", flight.calibration});
  CorvidProgram program(words);
  std::vector<std::int64_t> times_ns;
  std::size_t tracking = 0;
  for (std::size_t i = 0; i < flight.frames.size(); ++i) {
    if (i > 0) {
      ASSERT_TRUE(write(flight.frames[i]->grey));
    }
    const json pose = program.event("pose");
    ASSERT_TRUE(pose.is_object());
    ASSERT_EQ(pose["frame"], i) << pose;
    times_ns.push_back(pose["time_ns"]);
    tracking += pose["state"] == "tracking" ? 1 : 0;
  }
  program.signal(SIGTERM);
  const json end = program.event("end");
  EXPECT_EQ(program.exit_code(), 0);
  EXPECT_GE(tracking + 4, flight.frames.size()) << end;

  const json run = saved_run();
  ASSERT_TRUE(run.is_object());
  EXPECT_TRUE(run["interrupted"].get<bool>());
  EXPECT_EQ(run["frames"]["delivered"], flight.frames.size());
  for (const char* nothing : {"dropped", "skipped", "lost", "interruptions"}) {
    EXPECT_EQ(run["frames"][nothing], 0) << nothing;
  }
  const auto trajectory = read_trajectory(path("run/trajectory.txt"));
  ASSERT_TRUE(trajectory) << trajectory.error().to_string();
  EXPECT_GE(trajectory->size() + 2, flight.frames.size());
  std::vector<Eigen::Vector3d> estimated, truth;
  double length_m = 0;
  for (const StampedPose& pose : *trajectory) {
    // The file has microseconds at least.
    const auto at = std::find_if(times_ns.begin(), times_ns.end(), [&](std::int64_t time_ns) {
      return std::abs(time_ns - pose.time_ns) < 1'000;
    });
    ASSERT_NE(at, times_ns.end()) << pose.time_ns;
    estimated.push_back(pose.T_world_camera.translation());
    truth.push_back(
        flight.truth[static_cast<std::size_t>(at - times_ns.begin())].T_world_camera.translation());
    if (truth.size() > 1) length_m += (truth.back() - truth[truth.size() - 2]).norm();
  }
  const PointAlignment aligned = align_points(estimated, truth, true);
  ASSERT_TRUE(aligned.ok());
  std::printf("ATE %.3f m over %.1f m\n", aligned.rmse, length_m);
  EXPECT_LT(aligned.rmse, 0.02 * length_m);
}

/// The link that udev makes for a camera by its name and serial number.
std::string link_of(const std::string& node) {
  std::error_code none;
  for (const auto& entry : fs::directory_iterator("/dev/v4l/by-id", none)) {
    if (fs::weakly_canonical(entry.path(), none) == node) return entry.path().string();
  }
  return "";
}

/// Sets a camera up as other programs do: it keeps the size until it is unplugged.
void set_size(const std::string& node, unsigned width_px, unsigned height_px) {
  const int fd = ::open(node.c_str(), O_RDWR | O_CLOEXEC);
  v4l2_format format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  format.fmt.pix.width = width_px;
  format.fmt.pix.height = height_px;
  format.fmt.pix.pixelformat = V4L2_PIX_FMT_GREY;
  EXPECT_EQ(::ioctl(fd, VIDIOC_S_FMT, &format), 0);
  ::close(fd);
}

std::string reason_of(const json& pose) { return pose.value("reason", ""); }

TEST_F(Live, AUsbCameraIsListedAndFollowedByItsLinkThroughUnplugging) {
  EmulatedCamera camera;
  const std::string node = camera.node();
  std::string link;
  ASSERT_TRUE(eventually([&] { return !(link = link_of(node)).empty(); }));
  {
    CorvidProgram plain({"cameras"}), lines({"cameras", "--json"});
    EXPECT_THAT(plain.rest(), HasSubstr("v4l2:" + node + "\n  Test UVC Camera"));
    const auto listed = json::parse(lines.line().value_or(""), nullptr, false);
    EXPECT_EQ(plain.exit_code(), 0);
    EXPECT_EQ(lines.exit_code(), 0);
    ASSERT_TRUE(listed.is_object());
    EXPECT_EQ(listed["camera"], "v4l2:" + node);
    EXPECT_EQ(listed["driver"], "uvcvideo");
    EXPECT_EQ(listed["modes"].size(), 9u);
  }

  set_size(node, 320, 240);  // it has 640 x 480 whenever it is plugged in
  CorvidProgram program(arguments(link));
  const json start = program.event("start");
  EXPECT_EQ(start["source"]["camera"]["width_px"], 320);
  const auto has_picture = [&](const json& pose) {
    return reason_of(pose).find(link) == std::string::npos;
  };
  const auto is_blind = [&](const json& pose) { return !has_picture(pose); };
  program.event("pose", has_picture);

  // Another program that does not let go of the node: the camera comes back as another one.
  const int held = ::open(node.c_str(), O_RDWR | O_CLOEXEC);
  camera.unplug();
  json blind = program.event("pose", is_blind);
  ASSERT_TRUE(blind.is_object());
  EXPECT_THAT(reason_of(blind), HasSubstr(link + ": the camera is gone"));
  for (int i = 0; i < 4; ++i) {
    EXPECT_THAT(blind["state"], testing::AnyOf("lost", "starting")) << blind;
    EXPECT_FALSE(blind.contains("position"));
    const json next = program.event("pose");
    ASSERT_TRUE(next.is_object());
    EXPECT_TRUE(is_blind(next)) << next;
    // The first one may follow a picture closely.
    const std::int64_t apart_ns =
        next["time_ns"].get<std::int64_t>() - blind["time_ns"].get<std::int64_t>();
    EXPECT_GT(apart_ns, i == 0 ? 0 : 999'999'999);
    blind = next;
  }
  EXPECT_THAT(reason_of(blind), HasSubstr("there is no such device"));

  const EmulatedCamera again;
  EXPECT_NE(again.node(), node);
  program.event("pose", has_picture);
  program.event("pose", has_picture);
  ::close(held);
  program.signal(SIGTERM);
  const json end = program.event("end");
  // Its pictures are no scene.
  EXPECT_THAT(program.exit_code(), testing::AnyOf(0, 6)) << end;
  const json run = saved_run();
  ASSERT_TRUE(run.is_object());
  EXPECT_EQ(run["frames"]["interruptions"], 1);
  EXPECT_EQ(run["frames"]["skipped"], 0);
}

TEST_F(Live, ARecordingHasEachPictureOfAUsbCameraOnceAndInOrder) {
  EmulatedCamera camera;
  std::string link;
  ASSERT_TRUE(eventually([&] { return !(link = link_of(camera.node())).empty(); }));
  CorvidProgram program({"--quiet", "record", "--camera", "v4l2:" + link, "--size", "320x240",
                         "--pixels", "GREY", "--camera-rate", "15", "--buffer-mb", "64", "--out",
                         path("recording")});
  const auto sent = [](EmulatedCamera& one) {
    return eventually([&] { return one.command("count") >= 20; });
  };
  ASSERT_TRUE(sent(camera));
  camera.unplug();
  EmulatedCamera again;
  ASSERT_TRUE(sent(again));
  program.signal(SIGTERM);
  const std::string told = program.rest();
  EXPECT_EQ(program.exit_code(), 0);
  unsigned written = 0, lost = 0;
  ASSERT_EQ(std::sscanf(told.c_str(),
                        "%u frames, 0 skipped, 0 dropped, %u lost by the camera, 1 times away",
                        &written, &lost),
            2)
      << told;

  const auto source = open_source(path("recording"));
  ASSERT_TRUE(source) << source.error().to_string();
  std::uint32_t last = 0;
  std::int64_t last_ns = 0;
  unsigned count = 0, missing = 0, beginnings = 0;
  for (auto frame = (*source)->next(); frame && *frame; frame = (*source)->next(), ++count) {
    const GreyImage& grey = (*frame)->grey;
    ASSERT_EQ(grey.width(), 320);
    const std::uint32_t number = number_in(grey.data(), grey.width());
    if (count == 0 || number < last) {
      ++beginnings;
    } else {
      ASSERT_GT(number, last);
      missing += number - last - 1;
    }
    const auto sent_picture = numbered_picture(grey.width(), grey.height(), number);
    EXPECT_TRUE(std::equal(sent_picture.begin(), sent_picture.end(), grey.data())) << number;
    EXPECT_GT((*frame)->time_ns, last_ns);
    last = number;
    last_ns = (*frame)->time_ns;
  }
  EXPECT_EQ(count, written);
  EXPECT_GE(count, 20u);
  EXPECT_EQ(beginnings, 2u);
  EXPECT_EQ(missing, lost);
}

}  // namespace
}  // namespace corvid::vm
