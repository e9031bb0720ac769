// The commands that fly: replay, demo, export, on short synthetic flights.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <spdlog/sinks/null_sink.h>
#include <sys/stat.h>

#include <csignal>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "apps/command_flight.h"
#include "apps/live_export.h"
#include "apps/signal_guard.h"
#include "apps/talk.h"
#include "core/log.h"
#include "io/mesh_files.h"
#include "io/options_file.h"
#include "io/trajectory_file.h"
#include "program_fixture.h"
#include "replay/synthetic_flight.h"

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr const char* kFlight = "synthetic:width=320,height=240,duration=1.5,rate=20,seed=2";

using ReplayTest = ProgramTest;

std::vector<json> lines_of(const std::string& text) {
  std::vector<json> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(json::parse(line));
  return lines;
}

TEST_F(ReplayTest, WritesTheFolderAndSpeaksJson) {
  const Ran ran = corvid_run({"replay", kFlight, "--out", path("run"), "--json", "--set",
                              "frontend.max_tracks=300", "--threads", "2", "--surface", "both"});
  ASSERT_EQ(ran.code, 0) << ran.err;
  const std::vector<json> events = lines_of(ran.out);
  ASSERT_GE(events.size(), 32U);
  EXPECT_EQ(events.front()["event"], "start");
  EXPECT_EQ(events.front()["source"]["frames"], 30);
  EXPECT_EQ(events.back()["event"], "end");
  EXPECT_EQ(events.back()["exit_code"], 0);
  EXPECT_EQ(events.back()["source_counts"]["dropped"], 0);
  int frames = 0, with_pose = 0, blocks = 0;
  for (const json& event : events) {
    blocks += event["event"] == "mesh" ? 1 : 0;
    if (event["event"] != "pose") continue;
    EXPECT_EQ(event["frame"], frames);
    ++frames;
    if (!event.contains("position")) continue;
    ++with_pose;
    EXPECT_EQ(event["position"].size(), 3U);
    EXPECT_EQ(event["rotation_xyzw"].size(), 4U);
    EXPECT_EQ(event["covariance_upper"].size(), 21U);
  }
  EXPECT_EQ(frames, 30);
  EXPECT_GT(with_pose, 15);
  EXPECT_GT(blocks, 0);
  EXPECT_GE(events.back()["poses"].get<int>(), with_pose);
  EXPECT_LT(events.back()["ate"]["rmse_m"].get<double>(), 0.5);

  const auto trajectory = read_trajectory(path("run/trajectory.txt"));
  ASSERT_TRUE(trajectory) << trajectory.error().to_string();
  EXPECT_EQ(trajectory->size(), events.back()["poses"].get<std::size_t>());
  const auto options = read_options_file(path("run/options.yaml"));
  ASSERT_TRUE(options) << options.error().to_string();
  EXPECT_EQ(options->frontend.max_tracks, 300);
  const json run = json::parse(read(folder_ / "run/run.json"));
  EXPECT_THAT(run.dump(), HasSubstr("corvid replay"));
  EXPECT_EQ(run["source"], events.front()["source"]);
  EXPECT_GT(run["cut"]["triangles"], 100);
  EXPECT_GT(run["errors"]["cut"]["median_m"], 0);
  EXPECT_GE(run["stream"]["changed_blocks"], run["stream"]["blocks"]);
  EXPECT_GT(run["stream"]["blocks"], 0);
  EXPECT_GT(run["stream"]["send_s"], 0);
  EXPECT_THAT(read(folder_ / "run/report.html"), HasSubstr("</html>"));
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder_), {}), 1)
      << "nothing but the run's folder is left";

  // What the other commands make of the folder.
  for (const char* format : {"ply", "obj", "drc", "glb"}) {
    const std::string file = path(std::string("mesh.") + format);
    const Ran exported = corvid_run({"export", path("run"), "--format", format, "--out", file});
    ASSERT_EQ(exported.code, 0) << exported.err;
    const auto mesh = read_mesh(file);
    ASSERT_TRUE(mesh) << mesh.error().to_string();
    EXPECT_GT(mesh->triangles.size(), 100U) << format;
  }
  for (const char* format : {"ply", "glb"}) {
    const std::string file = path(std::string("cut.") + format);
    const Ran exported =
        corvid_run({"export", path("run"), "--format", format, "--surface", "cut", "--out", file});
    ASSERT_EQ(exported.code, 0) << exported.err;
    EXPECT_GT(read_mesh(file)->triangles.size(), 100U) << format;
  }
  ASSERT_EQ(mkfifo(path("pipe").c_str(), 0600), 0);
  std::filesystem::create_directories(folder_ / "full");
  write("full/letter.txt", "dear");
  for (const char* format : {"ply", "drc", "colmap"}) {
    for (const std::string& out : {std::string(), path("full"), path("pipe")}) {
      const Ran wrong = corvid_run({"export", path("run"), "--format", format, "--out", out});
      EXPECT_EQ(wrong.code, static_cast<int>(ExitCode::usage)) << format << " " << out;
    }
  }
  EXPECT_TRUE(std::filesystem::is_fifo(path("pipe")));
  std::filesystem::remove(path("pipe"));
  std::filesystem::create_symlink(path("mesh.drc"), path("link.drc"));
  EXPECT_EQ(corvid_run({"export", path("run"), "--format", "drc", "--out", path("link.drc")}).code,
            0);
  EXPECT_TRUE(std::filesystem::is_symlink(path("link.drc")));
  const Ran colmap = corvid_run({"export", path("run"), "--format", "colmap", "--out", path("c")});
  ASSERT_EQ(colmap.code, 0) << colmap.err;
  EXPECT_TRUE(std::filesystem::exists(folder_ / "c/sparse/cameras.txt"));
  const Ran eval = corvid_run({"eval", path("run"), kFlight, "--json"});
  ASSERT_EQ(eval.code, 0) << eval.err;
  EXPECT_NEAR(json::parse(eval.out)["ate_m"]["rmse"].get<double>(),
              events.back()["ate"]["rmse_m"].get<double>(), 1e-6);
}

TEST_F(ReplayTest, SumsUpOnTheStandardOutputAndTalksOnTheOther) {
  const Ran ran = corvid_run({"replay", kFlight, "--out", path("run"), "--no-mapping"}, true);
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, AllOf(HasSubstr("poses"), HasSubstr("ATE"), HasSubstr("30 delivered"),
                             HasSubstr(path("run/report.html"))));
  EXPECT_THAT(ran.out, ::testing::Not(HasSubstr("\r")));
  EXPECT_THAT(ran.err, HasSubstr("frame 1/30")) << "the progress line of a terminal";
  const Ran quiet =
      corvid_run({"replay", kFlight, "--out", path("run"), "--no-mapping", "-q"}, true);
  EXPECT_EQ(quiet.code, 0);
  EXPECT_THAT(quiet.err, IsEmpty());
  const Ran nothing = corvid_run({"export", path("run"), "--format", "ply"});
  EXPECT_EQ(nothing.code, static_cast<int>(ExitCode::not_found));
  EXPECT_THAT(nothing.err, HasSubstr("--no-mapping"));
  const Ran no_cut = corvid_run({"export", path("run"), "--format", "ply", "--surface", "cut"});
  EXPECT_EQ(no_cut.code, static_cast<int>(ExitCode::not_found));
  EXPECT_THAT(no_cut.err, HasSubstr("--surface cut"));
}

TEST_F(ReplayTest, AFlightWithoutTranslationEndsWithSixAndTheReason) {
  const Ran ran =
      corvid_run({"replay", "synthetic:width=320,height=240,duration=0.6,rate=20,path=hover",
                  "--out", path("run"), "--json"});
  EXPECT_EQ(ran.code, static_cast<int>(ExitCode::no_estimate)) << ran.err;
  EXPECT_THAT(ran.err, AllOf(HasSubstr("not one frame got a pose"), HasSubstr("frames)")));
  EXPECT_TRUE(std::filesystem::exists(folder_ / "run/report.html"));
  EXPECT_EQ(lines_of(ran.out).back()["exit_code"], 6);
}

TEST_F(ReplayTest, RefusesAFolderThatIsNotARunsBeforeItFlies) {
  std::filesystem::create_directories(folder_ / "mine");
  write("mine/letter.txt", "dear");
  const Ran ran = corvid_run({"replay", kFlight, "--out", path("mine"), "--json"});
  EXPECT_EQ(ran.code, static_cast<int>(ExitCode::usage));
  EXPECT_THAT(ran.out, IsEmpty());
  EXPECT_EQ(read(folder_ / "mine/letter.txt"), "dear");
  const std::string file = write("file", "x");
  for (const std::string& out : {std::string(), file, file + "/below"}) {
    const Ran wrong = corvid_run({"replay", kFlight, "--out", out});
    EXPECT_EQ(wrong.code, static_cast<int>(ExitCode::usage)) << out << ": " << wrong.err;
    EXPECT_EQ(corvid_run({"demo", "--quick", "--out", out}).code, static_cast<int>(ExitCode::usage))
        << out;
  }
}

TEST_F(ReplayTest, ADeviceThatIsNotThereEndsWithFive) {
  const Ran ran = corvid_run({"replay", kFlight, "--out", path("run"), "--device", "99"});
  EXPECT_EQ(ran.code, static_cast<int>(ExitCode::device)) << ran.err;
  EXPECT_FALSE(std::filesystem::exists(folder_ / "run"));
}

/// Some frames of a flight, then a fault.
class FailingSource final : public FrameSource {
 public:
  explicit FailingSource(std::size_t good) : good_(good) {}
  const SourceInfo& info() const override { return flight_.info(); }
  Expected<FramePtr> next(const std::stop_token&) override {
    if (given_ < good_) return flight_.render(given_++);
    return fail(ErrorCode::corrupt, "the cable came out", "camera 0");
  }
  SourceCounts counts() const override { return {given_, 0, 0, {}}; }

 private:
  static FlightOptions options() {
    FlightOptions options;
    options.width_px = 320;
    options.height_px = 240;
    options.duration_s = 2;
    return options;
  }
  SyntheticFlight flight_{options()};
  std::size_t good_, given_ = 0;
};

TEST_F(ReplayTest, ASourceThatFailsLeavesAPartialRunAndEndsWithOne) {
  for (const std::size_t good : {std::size_t{0}, std::size_t{30}}) {
    std::ostringstream out, err;
    Context context{out, err};
    set_logger(std::make_shared<spdlog::logger>("corvid", std::make_shared<Talk>(err)));
    FlightPlan plan;
    plan.source = std::make_unique<FailingSource>(good);
    plan.options.threads = 2;
    plan.options.mapping.enabled = false;
    plan.out = path("run");
    plan.json = true;
    const SignalGuard signals;
    const auto code = fly(std::move(plan), signals, context);
    set_logger(std::make_shared<spdlog::logger>("corvid",
                                                std::make_shared<spdlog::sinks::null_sink_mt>()));
    if (good == 0) {  // nothing to save: the fault is the result
      ASSERT_FALSE(code);
      EXPECT_EQ(code.error().code, ErrorCode::corrupt);
      EXPECT_FALSE(std::filesystem::exists(path("run")));
      continue;
    }
    ASSERT_TRUE(code) << code.error().to_string();
    EXPECT_EQ(*code, ExitCode::failure);
    EXPECT_THAT(err.str(), HasSubstr("The run ended early: camera 0: the cable came out"));
    const json end = lines_of(out.str()).back();
    EXPECT_EQ(end["exit_code"], 1);
    EXPECT_EQ(end["interrupted"], true);
    EXPECT_GT(end["poses"].get<int>(), 10);
    EXPECT_TRUE(read_trajectory(path("run/trajectory.txt")));
  }
}

TEST_F(ReplayTest, SigintSavesWhatThereIsAndEndsWith130) {
  SignallingBuffer buffer("\"frame\":38,",
                          2);  // well within the flight; the second one must change nothing
  std::ostream out(&buffer);
  std::ostringstream err;
  const std::string run = path("run");
  const char* argv[] = {
      "corvid",      "replay",    "synthetic:width=320,height=240,duration=30,rate=20",
      "--out",       run.c_str(), "--json",
      "--no-mapping"};
  const int code = run_program(7, argv, Context{out, err});
  EXPECT_EQ(code, 130) << err.str();
  EXPECT_THAT(err.str(), HasSubstr("what there is will be saved"));
  const std::vector<json> events = lines_of(buffer.str());
  EXPECT_EQ(events.back()["event"], "end");
  EXPECT_EQ(events.back()["interrupted"], true);
  EXPECT_LT(events.size(), 400U) << "it stopped long before the 600 frames of the flight";
  EXPECT_TRUE(std::filesystem::exists(folder_ / "run/report.html"));
  EXPECT_TRUE(read_trajectory(path("run/trajectory.txt")));
}

TEST_F(ReplayTest, WithoutTheCutThatWasAskedForTheLiveSurfaceIsThere) {
  // Stopped while flying, as soon as there is a mesh, and while the cut is under way.
  for (const char* moment : {"\"event\":\"mesh\"", "cutting the surface"}) {
    SignallingBuffer out_buffer(moment), err_buffer(moment);
    std::ostream out(&out_buffer), err(&err_buffer);
    const std::string run = path("run");
    const char* argv[] = {"corvid",    "replay", kFlight,     "--out",
                          run.c_str(), "--json", "--surface", "cut"};
    EXPECT_EQ(run_program(8, argv, Context{out, err}), 130) << err_buffer.str();
    EXPECT_TRUE(std::filesystem::exists(folder_ / "run/mesh.glb")) << moment;
    EXPECT_FALSE(std::filesystem::exists(folder_ / "run/mesh-cut.drc"));
    const json numbers = json::parse(read(folder_ / "run/run.json"));
    EXPECT_EQ(numbers["interrupted"], true) << moment;
    EXPECT_THAT(numbers["notes"].back().get<std::string>(),
                AllOf(HasSubstr("No surface by graph cut"), HasSubstr("asked to stop")));
  }
  // Depth maps that answer nowhere.
  const Ran none = corvid_run({"replay", kFlight, "--out", path("run"), "--surface", "cut", "--set",
                               "mapping.min_views=4", "--set", "mapping.min_score=0.99"});
  EXPECT_EQ(none.code, static_cast<int>(ExitCode::no_estimate)) << none.err;
  EXPECT_THAT(none.err, HasSubstr("No surface by graph cut"));
}

TEST_F(ReplayTest, TheLiveSurfaceCanBeHadUntilTheFolderIsThere) {
  // Comparing and writing take time; meanwhile the folder is absent, or is an earlier run's.
  const std::string run = path("run");
  std::size_t triangles = 0;
  WatchingBuffer buffer("writing " + run, [&] {
    const auto mesh = fetch_live_surface(run);
    if (mesh && *mesh) triangles = (*mesh)->triangles.size();
  });
  std::ostream err(&buffer);
  std::ostringstream out;
  const char* argv[] = {"corvid", "replay", kFlight, "--out", run.c_str()};
  ASSERT_EQ(run_program(5, argv, Context{out, err}), 0) << buffer.str();
  EXPECT_GT(triangles, 100U);
  const auto after = fetch_live_surface(run);
  ASSERT_TRUE(after);
  EXPECT_FALSE(after->has_value());
}

TEST(SignalGuard, TheThirdSignalEndsTheProcess) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(
      {
        const SignalGuard guard;
        for (int i = 0; i < 3; ++i) std::raise(SIGTERM);
        std::exit(0);
      },
      ::testing::ExitedWithCode(130), "");
}

TEST(SignalGuard, GivesTheOldHandlersBack) {
  static volatile std::sig_atomic_t heard = 0;
  std::signal(SIGTERM, [](int) { heard = heard + 1; });
  {
    const SignalGuard guard;
    std::raise(SIGPIPE);  // whoever read the events is gone: the run goes on
    std::raise(SIGTERM);
    while (!guard.token().stop_requested()) std::this_thread::yield();
    EXPECT_EQ(heard, 0);
  }
  std::raise(SIGTERM);
  EXPECT_EQ(heard, 1);
  std::signal(SIGTERM, SIG_DFL);
}

TEST_F(ReplayTest, DemoNamesTheReportAndBothErrors) {
  const Ran ran = corvid_run({"demo", "--quick", "--out", path("demo")});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, AllOf(HasSubstr("ATE"), HasSubstr("% of the length"),
                             HasSubstr("mesh error"), HasSubstr(path("demo/report.html"))));
}

}  // namespace
}  // namespace corvid
