#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "apps/program_fixture.h"
#include "io/source.h"
#include "replay/recording.h"
#include "replay/synthetic_flight.h"
#include "scenes/temporary_folder.h"

namespace corvid {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

/// A flight whose frames are rendered once for all that is recorded of them here.
const std::vector<FramePtr>& flight_frames() {
  static const std::vector<FramePtr> frames = [] {
    FlightOptions options;
    options.duration_s = 10;
    options.width_px = 128;
    options.height_px = 96;
    options.colour = false;
    options.seed = 5;
    SyntheticFlight flight(options);
    std::vector<FramePtr> all;
    while (FramePtr frame = flight.next().value()) all.push_back(std::move(frame));
    return all;
  }();
  return frames;
}

/// One `corvid ARGUMENTS...` in a process of its own, silent.
class Process {
 public:
  explicit Process(const std::vector<std::string>& arguments, rlim_t file_bytes = RLIM_INFINITY) {
    std::vector<char*> argv{const_cast<char*>(CORVID_PROGRAM)};
    for (const std::string& argument : arguments)
      argv.push_back(const_cast<char*>(argument.c_str()));
    argv.push_back(nullptr);
    pid_ = ::fork();
    if (pid_ != 0) return;
    const int null = ::open("/dev/null", O_RDWR);
    ::dup2(null, STDOUT_FILENO);
    ::dup2(null, STDERR_FILENO);
    if (file_bytes != RLIM_INFINITY) {
      const rlimit limit{file_bytes, file_bytes};
      ::setrlimit(RLIMIT_FSIZE, &limit);
      ::signal(SIGXFSZ, SIG_IGN);
    }
    ::execv(argv[0], argv.data());
    ::_exit(127);
  }
  ~Process() { end(SIGKILL); }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;
  /// Sends the signal (none: 0) and waits; the exit code, or minus the signal that ended it.
  int end(int signal) {
    if (pid_ <= 0) return status_;
    if (signal != 0) ::kill(pid_, signal);
    int status = 0;
    ::waitpid(pid_, &status, 0);
    pid_ = -1;
    return status_ = WIFSIGNALED(status) ? -WTERMSIG(status) : WEXITSTATUS(status);
  }
  [[nodiscard]] bool runs() const { return ::kill(pid_, 0) == 0; }

 private:
  pid_t pid_ = -1;
  int status_ = 0;
};

struct Form {
  const char *name, *list;
  bool lossless;
};
constexpr Form kForms[] = {{"flight", "flight/mav0/cam0/data.csv", true},
                           {"flight.mkv", "flight.times.csv", true},
                           {"flight.avi", "flight.times.csv", false}};

class RecordTest : public ProgramTest {
 protected:
  /// The flight three times over, as a source that starts at once.
  RecordTest() {
    SourceInfo info;
    Camera camera;
    camera.width_px = 128;
    camera.height_px = 96;
    camera.fx_px = camera.fy_px = 76;
    camera.cx_px = 63.5;
    camera.cy_px = 47.5;
    info.camera = std::make_shared<const Camera>(camera);
    info.rate_hz = 20;
    auto recording = open_recording(source_.path() / "source.mkv", std::nullopt, info);
    EXPECT_TRUE(recording.has_value());
    for (std::size_t i = 0; i < kFrames; ++i) {
      const auto written = (*recording)->write(source_frame(i));
      EXPECT_TRUE(written.has_value()) << written.error().to_string();
    }
    EXPECT_TRUE((*recording)->finish().has_value());
  }
  static constexpr std::size_t kFrames = 600;
  static Frame source_frame(std::size_t number) {
    Frame frame = *flight_frames()[number % flight_frames().size()];
    frame.time_ns = 1'403'638'127'245'096'960 + static_cast<std::int64_t>(number) * 50'000'001;
    return frame;
  }
  const TemporaryFolder source_;
  [[nodiscard]] std::string source() const { return source_.path() / "source.mkv"; }
  void begin_anew() const {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  /// Whole lines of the list but for the one that names the columns.
  [[nodiscard]] std::size_t lines(const char* list) const {
    const std::string text = read(path(list));
    const auto count = static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
    return count > 0 ? count - 1 : 0;
  }
  void wait_for_lines(const char* list, std::size_t count) const {
    for (int i = 0; i < 60'000 && lines(list) < count; ++i) std::this_thread::sleep_for(1ms);
    ASSERT_GE(lines(list), count);
  }
  /// Every frame that is listed is there and is the flight's, and no others are.
  void check(const Form& form, std::size_t listed, std::uint64_t skipped_at_most) const {
    auto source = open_source(path(form.name));
    ASSERT_TRUE(source.has_value()) << source.error().to_string();
    EXPECT_EQ((*source)->info().frames, listed);
    std::size_t count = 0;
    for (auto frame = (*source)->next(); frame && *frame; frame = (*source)->next(), ++count) {
      const Frame truth = source_frame(count);
      ASSERT_EQ((*frame)->time_ns, truth.time_ns) << form.name;
      if (form.lossless) {
        ASSERT_EQ((*frame)->grey, truth.grey) << form.name << " frame " << count;
        continue;
      }
      double difference = 0;
      for (std::size_t i = 0; i < truth.grey.size(); ++i)
        difference += std::abs((*frame)->grey.data()[i] - truth.grey.data()[i]);
      ASSERT_LT(difference / static_cast<double>(truth.grey.size()), 4) << "frame " << count;
    }
    EXPECT_EQ(count, listed) << form.name;
    EXPECT_LE((*source)->counts().skipped, skipped_at_most)
        << testing::PrintToString((*source)->counts().messages);
  }
};

TEST_F(RecordTest, KilledAtAnyMomentWhatIsListedIsWhole) {
  std::mt19937 random(7);
  for (const Form& form : kForms) {
    std::size_t most = 0;
    for (int kill = 0; kill < 20; ++kill) {
      begin_anew();
      Process process({"record", source(), "--out", path(form.name), "--threads", "2"});
      wait_for_lines(form.list, 1 + random() % 300);
      if (HasFatalFailure()) return;
      std::this_thread::sleep_for(std::chrono::microseconds(random() % 3'000));
      ASSERT_EQ(process.end(SIGKILL), -SIGKILL);
      const std::size_t listed = lines(form.list);
      most = std::max(most, listed);
      // One frame may have reached the disk without its line.
      check(form, listed, 1);
      if (HasFatalFailure()) return;
    }
    RecordProperty(form.name, static_cast<int>(most));
  }
}

TEST_F(RecordTest, ASignalCompletesTheRecording) {
  const std::string endless = "synthetic:duration=3600,width=64,height=48,colour=false";
  for (const Form& form : kForms) {
    begin_anew();
    Process process({"record", endless, "--out", path(form.name)});
    wait_for_lines(form.list, 3);
    EXPECT_EQ(process.end(SIGTERM), static_cast<int>(ExitCode::interrupted));
    auto source = open_source(path(form.name));
    ASSERT_TRUE(source.has_value()) << source.error().to_string();
    std::size_t count = 0;
    for (auto frame = (*source)->next(); frame && *frame; frame = (*source)->next()) ++count;
    EXPECT_EQ(count, lines(form.list));
    EXPECT_EQ((*source)->counts().skipped, 0u);
  }
}

TEST_F(RecordTest, AFileThatMayNotGrowEndsItWithWords) {
  for (const Form& form : {kForms[1], kForms[2]}) {
    begin_anew();
    Process process({"record", source(), "--out", path(form.name)}, 150'000);
    EXPECT_EQ(process.end(0), static_cast<int>(ExitCode::failure));
    EXPECT_GT(lines(form.list), 3u);
    check(form, lines(form.list), 1);
  }
}

TEST_F(RecordTest, AFullDiskEndsItWithWordsAndAReadableRecording) {
  const std::string disk = path("disk");
  std::filesystem::create_directories(disk);
  if (::mount("tmpfs", disk.c_str(), "tmpfs", 0, "size=300k") != 0)
    GTEST_SKIP() << "no right to mount a small disk";
  for (const Form& form : kForms) {
    const std::string out = std::string("disk/") + form.name,
                      list = std::string("disk/") + form.list;
    const Ran ran = corvid_run({"record", source(), "--out", path(out)});
    EXPECT_EQ(ran.code, static_cast<int>(ExitCode::failure)) << form.name << ran.err;
    EXPECT_THAT(ran.err, HasSubstr("No space left on device"));
    EXPECT_THAT(ran.err, HasSubstr("free some space"));
    EXPECT_THAT(ran.out, HasSubstr(fmt::format("{} frames", lines(list.c_str()))));
    EXPECT_GT(lines(list.c_str()), 3u) << form.name;
    check({out.c_str(), list.c_str(), form.lossless}, lines(list.c_str()), 1);
    for (const auto& entry : std::filesystem::directory_iterator(disk))
      std::filesystem::remove_all(entry.path());
  }
  EXPECT_EQ(::umount(disk.c_str()), 0);
}

TEST_F(RecordTest, FormatsAreChosenByNameOrByHand) {
  const std::string flight = "synthetic:duration=0.2,rate=20,width=64,height=48,colour=false";
  const auto ran = [&](const std::string& name, const std::string& format) {
    std::vector<std::string> arguments{"record", flight, "--out", path(name)};
    if (!format.empty()) arguments.insert(arguments.end(), {"--format", format});
    return corvid_run(arguments).code;
  };
  EXPECT_EQ(ran("a.mkv", ""), 0);
  EXPECT_EQ(ran("b.mkv", "mjpeg"), 0);
  EXPECT_EQ(ran("c.avi", "ffv1"), 0);
  EXPECT_EQ(ran("d", "asl"), 0);
  EXPECT_THAT(read(path("a.mkv")), HasSubstr("FFV1"));
  EXPECT_THAT(read(path("b.mkv")), HasSubstr("V_MJPEG"));
  const int usage = static_cast<int>(ExitCode::usage);
  EXPECT_EQ(ran("e", "ffv1"), usage);
  EXPECT_EQ(ran("e.mp4", ""), usage);
  EXPECT_EQ(ran("e.mkv", "asl"), usage);
  EXPECT_EQ(ran("e.mkv", "h264"), usage);
}

}  // namespace
}  // namespace corvid
