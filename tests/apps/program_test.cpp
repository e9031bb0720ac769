#include "apps/program.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <streambuf>

#include "core/log.h"
#include "io/options_file.h"
#include "program_fixture.h"

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr int code(ExitCode c) { return static_cast<int>(c); }

TEST(Program, HelpAndVersionGoToTheStandardOutput) {
  const Ran help = corvid_run({"--help"});
  EXPECT_EQ(help.code, 0);
  EXPECT_THAT(help.out, AllOf(HasSubstr("replay"), HasSubstr("Examples:"), HasSubstr("Exit codes"),
                              HasSubstr("XDG_CACHE_HOME")));
  EXPECT_THAT(help.err, IsEmpty());
  const Ran version = corvid_run({"--version"});
  EXPECT_EQ(version.code, 0);
  EXPECT_THAT(version.out, ::testing::MatchesRegex("corvid [0-9]+\\.[0-9]+\\.[0-9]+\n"));
  for (const char* command : {"replay", "info", "export", "eval", "record", "doctor", "demo",
                              "options", "match", "bench"}) {
    const Ran own = corvid_run({command, "--help"});
    EXPECT_EQ(own.code, 0) << command;
    EXPECT_THAT(own.out, HasSubstr("--help")) << command;
    EXPECT_THAT(own.err, IsEmpty()) << command;
  }
}

TEST(Program, WrongUsageIsTwoAndNamesTheNearest) {
  struct Case {
    std::vector<std::string> arguments;
    const char* said;
  };
  const Case cases[] = {
      {{}, "subcommand is required"},
      {{"replya", "x"}, "unknown command replya (did you mean replay?)"},
      {{"replay", "x", "--out", "y", "--devcie", "cpu"},
       "unknown option --devcie (did you mean --device?)"},
      {{"replay", "x", "--out", "y", "--thread=2"},
       "unknown option --thread=2 (did you mean --threads?)"},
      {{"replay", "x"}, "--out is required"},
      {{"info"}, "SOURCE is required"},
      {{"info", "x", "y"}, "unknown argument y"},
      {{"info", "x", "--step", "0"}, "--step"},
      {{"info", "x", "--first", "-1"}, "--first: must be at least 0, not -1 "},
      {{"info", "x", "--count", "0"}, "--count: must be at least 1, not 0 "},
      {{"info", "x", "--frame-rate", "0"}, "--frame-rate: must be more than 0, not 0 "},
      {{"eval", "a", "b", "--max-dt", "nan"}, "--max-dt: must be at least 0, not nan "},
      {{"eval", "a", "b", "--align", "affine"}, "affine"},
      {{"replay", "synthetic", "--out", "y", "--rate", "fast"}, "`fast` is not a rate"},
      {{"replay", "synthetic", "--out", "y", "--rate", "-1"}, "`-1` is not a rate"},
      {{"replay", "synthetic", "--out", "y", "--set", "threads"}, "threads is not KEY=VALUE"},
      {{"replay", "synthetic", "--out", "y", "--set", "thread=1"}, "did you mean threads?"},
      {{"replay", "synthetic", "--out", "y", "--threads", "-4"}, "threads"},
      {{"replay", "synthetic", "--out", "y", "--surface", "cut", "--no-mapping"},
       "no depth maps to cut it from"},
      {{"info", "synthetic:sede=3"}, "did you mean seed?"},
      {{"info", "synthetic:seed=x"}, "`x` is not a value of seed"},
      {{"info", "synthetic:path=moon"}, "survey, orbit"},
      {{"info", "synthetic:rate=-2"}, "rate_hz"},
      {{"info", "synthetic", "--first", "3"}, "are for files"},
      {{"export", "somewhere", "--format", "stl"}, "stl"},
  };
  for (const Case& c : cases) {
    const Ran ran = corvid_run(c.arguments);
    EXPECT_EQ(ran.code, code(ExitCode::usage)) << c.said;
    EXPECT_THAT(ran.err, HasSubstr(c.said));
    EXPECT_THAT(ran.err, HasSubstr("error: "));
    EXPECT_THAT(ran.out, IsEmpty()) << c.said;
  }
}

TEST(Program, HelpShowsOptionsAsTheyAreTyped) {
  const Ran help = corvid_run({"info", "--help"});
  EXPECT_THAT(help.out, HasSubstr("--grey "));
  EXPECT_THAT(help.out, Not(HasSubstr("{false}")));
  const Ran grey = corvid_run(
      {"info", "synthetic:duration=0.2,rate=10,width=160,height=120", "--grey", "--json"});
  EXPECT_EQ(json::parse(grey.out)["colour"], false) << grey.err;
}

// What /dev/full does to a stream.
struct FullDevice final : std::streambuf {
  int overflow(int) override { return traits_type::eof(); }
  std::streamsize xsputn(const char*, std::streamsize) override { return 0; }
  int sync() override { return -1; }
};

TEST(Program, ResultsThatCannotBeWrittenAreAFailure) {
  const std::vector<std::vector<const char*>> commands = {
      {"corvid", "--help"},
      {"corvid", "--version"},
      {"corvid", "replay", "--help"},
      {"corvid", "options"},
      {"corvid", "info", "synthetic:duration=0.2,rate=10,width=160,height=120"},
      {"corvid", "info", "synthetic:duration=0.2,rate=10,width=160,height=120", "--json"}};
  for (const auto& arguments : commands) {
    FullDevice full;
    std::ostream out(&full);
    std::ostringstream err;
    EXPECT_EQ(run_program(static_cast<int>(arguments.size()), arguments.data(), Context{out, err}),
              code(ExitCode::failure))
        << arguments.back();
    EXPECT_THAT(err.str(), HasSubstr("cannot be written to the standard output"));
  }
}

TEST(Program, EveryErrorCodeHasItsExitCode) {
  EXPECT_EQ(exit_code(ErrorCode::invalid_argument), ExitCode::usage);
  EXPECT_EQ(exit_code(ErrorCode::not_found), ExitCode::not_found);
  EXPECT_EQ(exit_code(ErrorCode::io), ExitCode::failure);
  EXPECT_EQ(exit_code(ErrorCode::corrupt), ExitCode::bad_input);
  EXPECT_EQ(exit_code(ErrorCode::unsupported), ExitCode::bad_input);
  EXPECT_EQ(exit_code(ErrorCode::device), ExitCode::device);
  EXPECT_EQ(exit_code(ErrorCode::interrupted), ExitCode::interrupted);
}

TEST(Program, TheLibraryFallsSilentAgain) {
  const Ran ran = corvid_run({"options"});
  EXPECT_EQ(ran.code, 0);
  log().error("nobody hears this");  // the streams of the run above are gone
  EXPECT_EQ(log().name(), "corvid");
}

TEST_F(ProgramTest, OptionsPrintsAFileThatReadsBack) {
  const Ran defaults = corvid_run({"options"});
  ASSERT_EQ(defaults.code, 0) << defaults.err;
  const auto read = parse_options(defaults.out, "printed");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(options_to_yaml(*read), options_to_yaml(Options{}));

  const std::string file = write("mine.yaml", "frontend: {max_tracks: 77}\n");
  const Ran mine = corvid_run({"options", "--options", file});
  EXPECT_THAT(mine.out, HasSubstr("max_tracks: 77"));
  const Ran wrong = corvid_run({"options", "--options", write("w.yaml", "\nfrontent.seed: 1\n")});
  EXPECT_EQ(wrong.code, code(ExitCode::usage));
  EXPECT_THAT(wrong.err, AllOf(HasSubstr("w.yaml:2"), HasSubstr("did you mean frontend.seed?")));
  EXPECT_EQ(corvid_run({"options", "--options", path("none")}).code, code(ExitCode::not_found));
}

TEST_F(ProgramTest, InfoSaysWhatASourceIs) {
  const Ran text = corvid_run({"info", "synthetic:duration=1,rate=10,width=160,height=120"});
  ASSERT_EQ(text.code, 0) << text.err;
  EXPECT_THAT(text.out, AllOf(HasSubstr("synthetic flight"), HasSubstr("160x120"),
                              HasSubstr("10 Hz"), HasSubstr("surface")));
  const Ran ran = corvid_run(
      {"info", "synthetic:duration=1,rate=10,width=160,height=120,seed=4", "--json", "--check"});
  ASSERT_EQ(ran.code, 0) << ran.err;
  const json j = json::parse(ran.out);
  EXPECT_EQ(j["kind"], "synthetic flight");
  EXPECT_EQ(j["camera"]["width_px"], 160);
  EXPECT_EQ(j["check"]["delivered"], j["frames"]);
  EXPECT_EQ(j["check"]["skipped"], 0);
  EXPECT_EQ(j["truth_poses"], j["frames"]);
  EXPECT_EQ(j["true_surface"], true);
}

TEST_F(ProgramTest, SourcesThatAreNotThereOrNothing) {
  const Ran absent = corvid_run({"info", path("absent")});
  EXPECT_EQ(absent.code, code(ExitCode::not_found));
  EXPECT_THAT(absent.err, AllOf(HasSubstr("error: "), HasSubstr(path("absent"))));
  const Ran nothing = corvid_run({"info", folder_.string()});
  EXPECT_EQ(nothing.code, code(ExitCode::bad_input));
  EXPECT_THAT(nothing.err, HasSubstr(folder_.string()));
}

TEST_F(ProgramTest, ARecordingIsTheSourceAgain) {
  const std::string flight = "synthetic:duration=0.5,rate=10,width=160,height=120,colour=false";
  const Ran recorded = corvid_run({"record", flight, "--out", path("town")});
  ASSERT_EQ(recorded.code, 0) << recorded.err;
  const Ran was = corvid_run({"info", flight, "--json"});
  const Ran is = corvid_run({"info", path("town"), "--json", "--check"});
  ASSERT_EQ(is.code, 0) << is.err;
  const json before = json::parse(was.out), after = json::parse(is.out);
  EXPECT_EQ(after["frames"], before["frames"]);
  EXPECT_EQ(after["check"]["delivered"], before["frames"]);
  for (const char* key : {"width_px", "height_px", "fx_px", "cy_px", "model"}) {
    EXPECT_EQ(after["camera"][key], before["camera"][key]) << key;
  }
  EXPECT_GE(after["truth_poses"].get<int>(), before["truth_poses"].get<int>());
  const Ran again = corvid_run({"record", flight, "--out", path("town")});
  EXPECT_NE(again.code, 0);
  EXPECT_THAT(again.err, HasSubstr(path("town")));
  const std::string file = write("file", "x");
  for (const std::string& out : {std::string(), file, file + "/below"}) {
    const Ran wrong = corvid_run({"record", flight, "--out", out});
    EXPECT_EQ(wrong.code, code(ExitCode::usage)) << out << ": " << wrong.err;
  }
}

// A curved path; the estimate is the same one scaled, turned about z, shifted, and 3 cm off by
// turns.
std::string tum_line(int i, bool estimate) {
  const double s = 0.05 * i;
  double x = 10 * std::sin(s), y = 3 * std::cos(2 * s), z = s;
  if (estimate) {
    z += i % 2 == 0 ? 0.03 : -0.03;
    const double turned = -0.5 * y + 7;
    y = 0.5 * x;
    x = turned;
    z = 0.5 * z - 2;
  }
  const double half = estimate ? std::numbers::pi / 4 : 0;
  return fmt::format("{:.2f} {} {} {} 0 0 {} {}\n", 100 + 0.1 * i, x, y, z, std::sin(half),
                     std::cos(half));
}

TEST_F(ProgramTest, EvalAlignsAndMeasures) {
  std::string truth, estimate;
  for (int i = 0; i < 100; ++i) {
    truth += tum_line(i, false);
    if (i % 2 == 0 || i % 5 == 0) estimate += tum_line(i, true);
  }
  const std::string e = write("estimate.txt", estimate), t = write("truth.txt", truth);
  const Ran ran = corvid_run({"eval", e, t, "--json"});
  ASSERT_EQ(ran.code, 0) << ran.err;
  const json j = json::parse(ran.out);
  EXPECT_EQ(j["matched"], 60);
  EXPECT_NEAR(j["scale"].get<double>(), 2.0, 0.01);
  EXPECT_LT(j["ate_m"]["rmse"].get<double>(), 0.03);
  EXPECT_GT(j["ate_m"]["rmse"].get<double>(), 0.01);
  EXPECT_LT(j["orientation_deg"]["max"].get<double>(), 1.0);

  const Ran rigid = corvid_run({"eval", e, t, "--align", "se3", "--json"});
  EXPECT_GT(json::parse(rigid.out)["ate_m"]["rmse"].get<double>(), 1.0) << "the scale is off";
  const Ran text = corvid_run({"eval", e, t});
  EXPECT_THAT(text.out, AllOf(HasSubstr("ATE"), HasSubstr("RPE"), HasSubstr("KITTI")));

  std::filesystem::create_directories(folder_ / "run");
  std::filesystem::copy(e, folder_ / "run/trajectory.txt");
  EXPECT_EQ(corvid_run({"eval", path("run"), t, "--json"}).out, ran.out)
      << "a run's folder will do";
  std::filesystem::create_directories(folder_ / "other");
  std::filesystem::copy(t, folder_ / "other/trajectory.txt");
  write("other/run.json", "{}");
  EXPECT_EQ(corvid_run({"eval", path("run"), path("other"), "--json"}).out, ran.out)
      << "on either side";
}

TEST_F(ProgramTest, EvalNamesTheFileThatAFolderLacks) {
  const std::string t = write("t.txt", tum_line(0, false) + tum_line(1, false));
  std::filesystem::create_directories(folder_ / "empty");
  const Ran none = corvid_run({"eval", path("empty"), t});
  EXPECT_EQ(none.code, code(ExitCode::not_found));
  EXPECT_THAT(none.err, AllOf(HasSubstr(path("empty/trajectory.txt")), HasSubstr("opened")));
  write("empty/run.json", "{}");
  const Ran broken = corvid_run({"eval", t, path("empty")});
  EXPECT_EQ(broken.code, code(ExitCode::not_found));
  EXPECT_THAT(broken.err, HasSubstr(path("empty/trajectory.txt")));
}

TEST_F(ProgramTest, EvalTakesNoDataSetForARun) {
  const std::string t =
      write("t.txt", tum_line(0, false) + tum_line(1, false) + tum_line(2, false));
  std::filesystem::create_directories(folder_ / "photos");
  std::filesystem::copy(t, folder_ / "photos/trajectory.txt");
  const Ran ran = corvid_run({"eval", t, path("photos")});
  EXPECT_NE(ran.code, 0) << "its trajectory.txt need not be the truth";
  EXPECT_THAT(ran.err, HasSubstr("photos"));
  EXPECT_THAT(ran.out, IsEmpty());
}

TEST_F(ProgramTest, EvalRefusesWhatCannotBeCompared) {
  const std::string t =
      write("t.txt", tum_line(0, false) + tum_line(1, false) + tum_line(2, false));
  EXPECT_EQ(corvid_run({"eval", path("none.txt"), t}).code, code(ExitCode::not_found));
  EXPECT_EQ(corvid_run({"eval", t, path("none")}).code, code(ExitCode::not_found));
  const Ran corrupt = corvid_run({"eval", write("c.txt", "1 2 3\n"), t});
  EXPECT_EQ(corrupt.code, code(ExitCode::bad_input));
  EXPECT_THAT(corrupt.err, HasSubstr("c.txt:1"));
  const Ran apart = corvid_run(
      {"eval", write("apart.txt", "900 0 0 0 0 0 0 1\n901 1 0 0 0 0 0 1\n902 0 1 0 0 0 0 1\n"), t});
  EXPECT_EQ(apart.code, code(ExitCode::bad_input));
  EXPECT_THAT(apart.err, HasSubstr("--max-dt"));
  EXPECT_THAT(apart.out, Not(HasSubstr("nan")));
}

}  // namespace
}  // namespace corvid
