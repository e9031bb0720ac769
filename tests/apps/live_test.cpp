#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>

#include <chrono>
#include <csignal>
#include <functional>
#include <nlohmann/json.hpp>
#include <random>
#include <thread>

#include "apps/program_fixture.h"
#include "core/alignment.h"
#include "io/calibration.h"
#include "io/camera/libcamera_camera.h"
#include "io/camera/v4l2_camera.h"
#include "io/trajectory_file.h"
#include "replay/synthetic_flight.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

constexpr double kRate_hz = 10;
constexpr std::size_t kFrames = 50;

const SyntheticFlight& flight_of_the_tests() {
  static const SyntheticFlight flight = [] {
    FlightOptions options;
    options.width_px = 320;
    options.height_px = 240;
    options.rate_hz = kRate_hz;
    options.duration_s = static_cast<double>(kFrames) / kRate_hz;
    options.colour = false;
    return SyntheticFlight(options);
  }();
  return flight;
}

/// Its frames as a YUV4MPEG2 stream, rendered once.
const std::vector<std::string>& stream_parts() {
  static const std::vector<std::string> parts = [] {
    const SyntheticFlight& flight = flight_of_the_tests();
    std::vector<std::string> out = {"YUV4MPEG2 W320 H240 F10:1 Ip A1:1 Cmono\n"};
    for (std::size_t i = 0; i < kFrames; ++i) {
      const FramePtr frame = flight.render(i);
      out.push_back("FRAME\n" + std::string(reinterpret_cast<const char*>(frame->grey.data()),
                                            frame->grey.size()));
    }
    return out;
  }();
  return parts;
}

/// Writes the stream into a fifo at the pace of a camera, as often as asked; stays quiet when the
/// reader goes.
class Camera {
 public:
  Camera(std::string path, std::chrono::milliseconds interval, std::size_t frames = kFrames)
      : path_(std::move(path)) {
    EXPECT_EQ(mkfifo(path_.c_str(), 0600), 0);
    (void)stream_parts();
    thread_ = std::jthread([this, interval, frames](const std::stop_token& stop) {
      int fd = -1;
      while (fd < 0 && !stop.stop_requested()) {  // until there is a reader
        fd = open(path_.c_str(), O_WRONLY | O_NONBLOCK | O_CLOEXEC);
        if (fd < 0) std::this_thread::sleep_for(std::chrono::milliseconds(10));
      }
      fcntl(fd, F_SETFL, 0);
      auto due = std::chrono::steady_clock::now();
      for (std::size_t i = 0; i <= frames && !stop.stop_requested(); ++i) {
        std::string_view rest = stream_parts()[i];
        while (!rest.empty()) {
          const ssize_t n = write(fd, rest.data(), rest.size());
          if (n <= 0) break;
          rest.remove_prefix(static_cast<std::size_t>(n));
        }
        if (!rest.empty()) break;
        if (i > 0) std::this_thread::sleep_until(due += interval);
      }
      close(fd);
    });
  }
  [[nodiscard]] std::string spec() const { return "y4m:" + path_; }

 private:
  std::string path_;
  std::jthread thread_;
};

class LiveTest : public ProgramTest {
 protected:
  LiveTest() { std::signal(SIGPIPE, SIG_IGN); }  // of the cameras, when nobody reads any more
  [[nodiscard]] static std::vector<std::string> arguments(const std::string& camera,
                                                          const std::string& out) {
    return {"live", "--camera",     camera,  "--out",
            out,    "--no-mapping", "--set", "frontend.max_tracks=300"};
  }
  /// A flight that SIGTERM ends with the first pose; what it printed is left out.
  [[nodiscard]] static Ran stopped_run(std::vector<std::string> words) {
    words.emplace_back("--json");
    std::vector<const char*> argv{"corvid"};
    for (const std::string& word : words) argv.push_back(word.c_str());
    WatchingBuffer poses("\"state\":\"tracking\"", [] { std::raise(SIGTERM); });
    std::ostream out(&poses);
    std::ostringstream err;
    const int code = run_program(static_cast<int>(argv.size()), argv.data(), Context{out, err});
    return {code, "", err.str()};
  }
  /// Folders of runs that were not ended.
  [[nodiscard]] std::vector<fs::path> leftovers() const {
    std::vector<fs::path> found;
    for (const auto& entry : fs::directory_iterator(folder_))
      if (entry.path().filename().string().find(".live") != std::string::npos)
        found.push_back(entry.path());
    return found;
  }
};

TEST_F(LiveTest, AStreamIsFlownToItsEnd) {
  const Camera camera(path("camera"), std::chrono::milliseconds(100));
  const Ran ran = corvid_run(arguments(camera.spec(), path("run")));
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, HasSubstr("YUV4MPEG2 stream"));
  const auto trajectory = read_trajectory(path("run/trajectory.txt"));
  ASSERT_TRUE(trajectory) << trajectory.error().to_string();
  EXPECT_GE(trajectory->size(), kFrames / 2);
  const auto json = nlohmann::json::parse(read(path("run/run.json")));
  EXPECT_EQ(
      json["frames"]["delivered"].get<std::size_t>() + json["frames"]["dropped"].get<std::size_t>(),
      kFrames);
  EXPECT_FALSE(json["interrupted"].get<bool>());
  EXPECT_TRUE(leftovers().empty()) << "what is for crashes goes when the folder is there";
  EXPECT_FALSE(fs::exists(path("run/colmap")));
}

TEST_F(LiveTest, ASignalEndsItAndTheMapIsSaved) {
  const Camera camera(path("camera"), std::chrono::milliseconds(100));
  const Ran ran = stopped_run(arguments(camera.spec(), path("run")));
  EXPECT_EQ(ran.code, 0) << ran.err;
  EXPECT_TRUE(nlohmann::json::parse(read(path("run/run.json")))["interrupted"].get<bool>());
  EXPECT_TRUE(read_trajectory(path("run/trajectory.txt")));
  EXPECT_TRUE(leftovers().empty());
}

TEST_F(LiveTest, ARecordingReplaysToTheSameTrajectory) {
  ASSERT_TRUE(write_calibration(path("camera.yaml"), flight_of_the_tests().camera(),
                                CalibrationFormat::opencv));
  // A busy machine may be too slow for a camera; then a slower one.
  bool dropped = true;
  std::string run, recording;
  for (int interval_ms = 150; dropped && interval_ms <= 1000; interval_ms *= 2) {
    const std::string number = std::to_string(interval_ms);
    run = path("run" + number);
    recording = path("rec" + number + ".mkv");
    const Camera camera(path("camera" + number), std::chrono::milliseconds(interval_ms));
    auto words = arguments(camera.spec(), run);
    words.insert(words.end(), {"--record", recording, "--calibration", path("camera.yaml")});
    const Ran live = corvid_run(words);
    ASSERT_EQ(live.code, 0) << live.err;
    dropped = nlohmann::json::parse(read(run + "/run.json"))["frames"]["dropped"] != 0;
  }
  if (dropped) GTEST_SKIP() << "the machine is too busy for any camera: frames were dropped";
  const Ran replay = corvid_run({"replay", recording, "--out", path("again"), "--no-mapping",
                                 "--set", "frontend.max_tracks=300"});
  ASSERT_EQ(replay.code, 0) << replay.err;
  const auto a = read_trajectory(run + "/trajectory.txt");
  const auto b = read_trajectory(path("again/trajectory.txt"));
  ASSERT_TRUE(a && b);
  ASSERT_EQ(a->size(), b->size());
  std::vector<Eigen::Vector3d> from, to;
  double length = 0;
  for (std::size_t k = 0; k < a->size(); ++k) {
    EXPECT_EQ((*a)[k].time_ns, (*b)[k].time_ns);
    from.push_back((*a)[k].T_world_camera.translation());
    to.push_back((*b)[k].T_world_camera.translation());
    if (k > 0) length += (to[k] - to[k - 1]).norm();
  }
  const PointAlignment aligned = align_points(from, to, true);
  ASSERT_EQ(aligned.status, AlignmentStatus::ok);
  std::printf("live and replayed differ by %.4f %% of the way\n", 100 * aligned.rmse / length);
  EXPECT_LT(aligned.rmse, 0.002 * length);
}

TEST_F(LiveTest, AFlightThatCannotBeRecordedLeavesNothing) {
  const Camera camera(path("camera"), std::chrono::milliseconds(100));
  auto words = arguments(camera.spec(), path("run"));
  words.insert(words.end(), {"--record", write("there.mkv", "a recording")});
  const Ran ran = corvid_run(words);
  EXPECT_EQ(ran.code, 2) << ran.err;
  EXPECT_THAT(ran.err, HasSubstr("there is a recording already"));
  EXPECT_FALSE(fs::exists(path("run")));
  EXPECT_TRUE(leftovers().empty());
}

/// A service manager's end of the notification socket, which holds ten messages.
class NotifySocket {
 public:
  NotifySocket()
      : path_((fs::temp_directory_path() / fmt::format("corvid-notify-{}", getpid())).string()) {
    unlink(path_.c_str());
    fd_ = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path_.copy(address.sun_path, sizeof address.sun_path - 1);
    EXPECT_EQ(bind(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    setenv("NOTIFY_SOCKET", path_.c_str(), 1);
    setenv("WATCHDOG_USEC", "1000000", 1);
    unsetenv("WATCHDOG_PID");
  }
  ~NotifySocket() {
    unsetenv("NOTIFY_SOCKET");
    unsetenv("WATCHDOG_USEC");
    close(fd_);
    unlink(path_.c_str());
  }
  [[nodiscard]] std::vector<std::string> take() const {
    std::vector<std::string> messages;
    char buffer[4096];
    while (true) {
      const ssize_t n = recv(fd_, buffer, sizeof buffer, MSG_DONTWAIT);
      if (n < 0) return messages;
      messages.emplace_back(buffer, static_cast<std::size_t>(n));
    }
  }
  /// All that comes while something is done.
  [[nodiscard]] std::vector<std::string> take_during(const std::function<void()>& action) const {
    std::vector<std::string> messages;
    const auto take_all = [&] {
      for (std::string& m : take()) messages.push_back(std::move(m));
    };
    {
      const std::jthread reader([&](const std::stop_token& stop) {
        for (; !stop.stop_requested(); std::this_thread::sleep_for(std::chrono::milliseconds(20)))
          take_all();
      });
      action();
    }
    take_all();
    return messages;
  }

 private:
  std::string path_;
  int fd_ = -1;
};

TEST_F(LiveTest, TheServiceManagerIsToldByTheTrackingLoop) {
  const NotifySocket manager;
  const Camera camera(path("camera"), std::chrono::milliseconds(100), 30);
  const auto messages = manager.take_during([&] {
    const Ran ran = corvid_run(arguments(camera.spec(), path("run")));
    EXPECT_TRUE(ran.code == 0 || ran.code == 6) << ran.err;
  });
  ASSERT_FALSE(messages.empty());
  EXPECT_EQ(std::count(messages.begin(), messages.end(), "READY=1"), 1);
  EXPECT_EQ(messages.front(), "READY=1");
  // A sign of life every quarter of a second, from frames alone.
  const auto alive = std::count(messages.begin(), messages.end(), "WATCHDOG=1");
  EXPECT_GE(alive, 3);
  EXPECT_LE(alive, 30);
  EXPECT_THAT(messages, testing::Contains(testing::StartsWith("STATUS=")));
}

TEST_F(LiveTest, AfterASignalTheServiceManagersWatchdogWaits) {
  const NotifySocket manager;
  const Camera camera(path("camera"), std::chrono::milliseconds(100));
  const auto messages = manager.take_during([&] {
    const Ran ran = stopped_run(arguments(camera.spec(), path("run")));
    EXPECT_EQ(ran.code, 0) << ran.err;
  });
  // In one message: no frame needs to come after it.
  EXPECT_THAT(messages, testing::Contains(testing::AllOf(testing::StartsWith("STOPPING=1\n"),
                                                         HasSubstr("WATCHDOG_USEC=3600000000"))));
}

TEST_F(LiveTest, AServiceManagerThatDoesNotReadHoldsUpNothing) {
  const NotifySocket manager;
  const Camera camera(path("camera"), std::chrono::milliseconds(100));
  const Ran ran = corvid_run(arguments(camera.spec(), path("run")));
  EXPECT_EQ(ran.code, 0) << ran.err;
  const auto messages = manager.take();
  ASSERT_FALSE(messages.empty());
  EXPECT_EQ(messages.front(), "READY=1");
}

TEST_F(LiveTest, TheJournalIsToldPriorities) {
  const std::string log = path("log");
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    const int fd = open(log.c_str(), O_WRONLY | O_CREAT, 0600);
    struct stat file {};
    fstat(fd, &file);
    dup2(fd, STDERR_FILENO);
    setenv("JOURNAL_STREAM", fmt::format("{}:{}", file.st_dev, file.st_ino).c_str(), 1);
    execl(CORVID_PROGRAM, "corvid", "live", "--camera", "v4l2:/dev/video987", nullptr);
    _exit(127);
  }
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_EQ(WEXITSTATUS(status), 3);
  EXPECT_THAT(read(log), testing::StartsWith("<3>")) << read(log);
}

TEST_F(LiveTest, AfterAKillWhatWasWrittenIsReadable) {
  constexpr unsigned kSeed = 7;
  std::mt19937 random(kSeed);
  std::printf("seed %u\n", kSeed);
  std::size_t poses = 0;
  for (int kill_number = 0; kill_number < 20; ++kill_number) {
    const auto after = std::chrono::milliseconds(300 + random() % 2500);
    // A pipe that stays open, so that only the kill ends the run.
    int fds[2];
    ASSERT_EQ(pipe(fds), 0);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      dup2(fds[0], STDIN_FILENO);
      close(fds[0]);
      close(fds[1]);
      const int null = open("/dev/null", O_WRONLY);
      dup2(null, STDOUT_FILENO);
      dup2(null, STDERR_FILENO);
      execl(CORVID_PROGRAM, "corvid", "live", "--camera", "y4m:-", "--out", path("run").c_str(),
            "--no-mapping", "--set", "frontend.max_tracks=300", nullptr);
      _exit(127);
    }
    close(fds[0]);
    std::jthread feed([&, fd = fds[1]] {
      for (const std::string& part : stream_parts()) {
        if (::write(fd, part.data(), part.size()) < 0) break;
        std::this_thread::sleep_for(std::chrono::milliseconds(30));
      }
    });
    std::this_thread::sleep_for(after);
    ::kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    ASSERT_TRUE(WIFSIGNALED(status)) << "it ended by itself: status " << status;
    feed.join();
    close(fds[1]);
    EXPECT_FALSE(fs::exists(path("run"))) << "a folder that is not whole has no name";
    for (const fs::path& folder : leftovers()) {
      const std::string text = read(folder / "poses.txt");
      if (text.empty()) continue;  // killed before the first line
      EXPECT_TRUE(text.ends_with('\n'));
      const auto trajectory = read_trajectory((folder / "poses.txt").string());
      if (text.find("# segment") == std::string::npos) continue;
      ASSERT_TRUE(trajectory) << trajectory.error().to_string();
      poses += trajectory->size();
    }
    EXPECT_LE(leftovers().size(), static_cast<std::size_t>(kill_number + 1));
  }
  EXPECT_GT(poses, 0U) << "not one run lived long enough for a pose";
}

TEST_F(LiveTest, WrongCamerasAreErrorsThatSayWhatToDo) {
  const Ran none = corvid_run({"live", "--camera", "v4l2:/dev/video987", "--out", path("run")});
  EXPECT_EQ(none.code, 3) << none.err;
  EXPECT_THAT(none.err, HasSubstr("/dev/video987"));
  const Ran bare = corvid_run({"live", "--camera", "/dev/video0", "--out", path("run")});
  EXPECT_EQ(bare.code, 2);
  EXPECT_THAT(bare.err, HasSubstr("v4l2:/dev/video0"));
  const Ran size = corvid_run({"live", "--camera", "y4m:-", "--size", "640", "--out", path("run")});
  EXPECT_EQ(size.code, 2);
  EXPECT_THAT(size.err, HasSubstr("640x480"));
  EXPECT_FALSE(fs::exists(path("run")));
  EXPECT_TRUE(leftovers().empty());
}

TEST_F(LiveTest, CamerasAreListedOrTheListSaysThatThereAreNone) {
  const Ran ran = corvid_run({"cameras"});
  std::vector<CameraListing> cameras = list_v4l2_cameras();
  for (CameraListing& camera : list_libcamera_cameras()) cameras.push_back(std::move(camera));
  EXPECT_EQ(ran.code, cameras.empty() ? 3 : 0) << ran.err;
  for (const CameraListing& camera : cameras) EXPECT_THAT(ran.out, HasSubstr(camera.id));
  EXPECT_EQ(ran.err.find("there is no camera") != std::string::npos, cameras.empty());
}

}  // namespace
}  // namespace corvid
