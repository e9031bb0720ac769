#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <csignal>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <utility>

#include "program_fixture.h"

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

using BenchTest = ProgramTest;

void expect_sane(const json& row) {
  EXPECT_GT(row["corvid_ms"], 0) << row;
  EXPECT_GT(row["opencv_ms"], 0) << row;
  EXPECT_NEAR(row["ratio"].get<double>(),
              row["opencv_ms"].get<double>() / row["corvid_ms"].get<double>(),
              1e-6 * row["ratio"].get<double>());
  EXPECT_GT(row["peak_gflops"], 0) << row;
  EXPECT_GT(row["copy_gbytes_s"], 0) << row;
}

void expect_sane_rate(const json& row) {
  const double products =
      row["template_px"].get<double>() * row["template_height_px"].get<double>();
  const double gflops =
      2 * products * row["coefficients"].get<double>() / row["corvid_ms"].get<double>() * 1e-6;
  EXPECT_NEAR(row["gflops"].get<double>(), gflops, 1e-6 * gflops) << row;
  EXPECT_GT(row["share_of_peak"], 0) << row;
  EXPECT_LE(row["share_of_peak"], 10) << row;
}

TEST_F(BenchTest, TheDenseGridComesAsTextAndAsRows) {
  const std::string file = path("ncc.json");
  const Ran ran = corvid_run({"bench", "ncc", "--quick", "--runs", "1", "--tables", "dense",
                              "--templates", "3,5", "--images", "64,128", "--json", file});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, AllOf(HasSubstr("load average"), HasSubstr("driver"), HasSubstr("OpenCV"),
                             HasSubstr("GFLOP/s"), HasSubstr("GB/s"), HasSubstr("TM_CCOEFF")));
  EXPECT_THAT(ran.err, AllOf(HasSubstr("kernels for 3x3"), HasSubstr("5x5 in 128x128")));
  const json rows = json::parse(read(file));
  ASSERT_EQ(rows.size(), 4U);
  std::size_t i = 0;
  for (const int side : {64, 128}) {
    for (const int size : {3, 5}) {
      const json& row = rows[i++];
      EXPECT_EQ(row["table"], "dense");
      EXPECT_EQ(row["template_px"], size);
      EXPECT_EQ(row["image_px"], side);
      EXPECT_EQ(row["runs"], 1);
      EXPECT_EQ(row["coefficients"], (side - size + 1) * (side - size + 1));
      EXPECT_GT(row["upload_ms"], 0);
      EXPECT_LT(row["largest_difference"], 5e-3) << "not the coefficients that OpenCV computes";
      expect_sane(row);
      expect_sane_rate(row);
      EXPECT_THAT(ran.out, HasSubstr(fmt::format("{0}x{0}", size)));
    }
  }
}

TEST_F(BenchTest, BatchesAndFeaturesAreMeasuredToo) {
  const std::string file = path("ncc.json");
  const Ran ran = corvid_run({"bench", "ncc", "--quick", "--runs", "1", "--tables",
                              "features,strips", "--json", file, "-q"});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.err, IsEmpty()) << "-q leaves warnings and errors";
  const json rows = json::parse(read(file));
  ASSERT_EQ(rows.size(), 4U);
  EXPECT_EQ(rows[0]["table"], "strips");
  expect_sane_rate(rows[0]);
  EXPECT_EQ(rows[1]["coefficients"], 3000 * 21 * 641);
  expect_sane(rows[1]);
  expect_sane_rate(rows[1]);
  const auto rate = [&](int i) { return rows[i]["gcoefficients_per_s"].get<double>(); };
  EXPECT_NEAR(rows[1]["share_of_dense"].get<double>(), rate(1) / rate(0), 1e-6);
  for (const int i : {2, 3}) {
    EXPECT_EQ(rows[i]["table"], "features");
    EXPECT_TRUE(rows[i]["template_px"].is_null());
    expect_sane(rows[i]);
  }
}

TEST_F(BenchTest, WrongArgumentsAreNamed) {
  struct Case {
    std::vector<std::string> arguments;
    const char* said;
  };
  const Case cases[] = {
      {{"bench"}, "`corvid bench --help`"},
      {{"bench", "nc"}, "unknown command nc (did you mean ncc?)"},
      {{"bench", "ncc", "--jsn", "x"}, "unknown option --jsn (did you mean --json?)"},
      {{"bench", "ncc", "extra"}, "unknown argument extra (`corvid bench ncc --help`"},
      {{"bench", "ncc", "--runs", "0"}, "--runs"},
      {{"bench", "ncc", "--runs", "many"}, "`corvid bench ncc --help`"},
      {{"bench", "ncc", "--tables", "dense,sparse"}, "sparse"},
      {{"bench", "ncc", "--templates", "4"}, "a template of 4 px is not odd and 3 to 31"},
      {{"bench", "ncc", "--templates", "33"}, "a template of 33 px"},
      {{"bench", "ncc", "--templates", "11,x"}, "--templates"},
      {{"bench", "ncc", "--templates", "11", "--images", "64,9"}, "9x9 px is smaller"},
      {{"bench", "ncc", "--images", "20000"}, "larger than"},
      {{"bench", "ncc", "--json", folder_.string()}, "is a folder"},
      {{"bench", "ncc", "--json", ""}, "the file's name is empty"},
      {{"bench", "ncc", "--json", path("new") + "/"}, "is not a file name"},
      {{"bench", "ncc", "--json", "/dev/null"}, "is not a regular file"},
      {{"bench", "matching"}, "SOURCE"},
      {{"bench", "matching", "synthetic", "--pairs", "2"}, "--pairs"},
      {{"bench", "matching", "synthetic", "--json", folder_.string()}, "is a folder"},
      {{"bench", "matching", "synthetic:seeed=1"}, "seeed"},
      {{"bench", "matching", "synthetic:duration=0.1,rate=10,width=64,height=64"},
       "fewer than two images"},
      {{"bench", "tracking"}, "SOURCE"},
      {{"bench", "tracking", "synthetic", "--tracks", "3"}, "--tracks"},
      {{"bench", "tracking", "synthetic", "--count", "0"}, "--count"},
      {{"bench", "tracking", "synthetic", "--json", folder_.string()}, "is a folder"},
      {{"bench", "tracking", "synthetic:seeed=1"}, "seeed"},
      {{"bench", "mapping", "synthetic", "--count", "4"}, "--count"},
      {{"bench", "mapping", "synthetic", "--json", folder_.string()}, "is a folder"},
      {{"bench", "mapping", "synthetic:seeed=1"}, "seeed"},
  };
  for (const Case& c : cases) {
    const Ran ran = corvid_run(c.arguments);
    EXPECT_EQ(ran.code, 2) << c.said;
    EXPECT_THAT(ran.err, AllOf(HasSubstr("error: "), HasSubstr(c.said)));
    EXPECT_THAT(ran.out, IsEmpty()) << c.said;
  }
  EXPECT_THAT(corvid_run({"bench", "--help"}).out, AllOf(HasSubstr("ncc"), HasSubstr("matching")));
  EXPECT_EQ(corvid_run({"bench", "matching", path("nowhere")}).code, 3);
  EXPECT_EQ(corvid_run({"bench", "mapping", path("nowhere")}).code, 3);
  EXPECT_THAT(corvid_run({"bench", "ncc", "--help"}).out, HasSubstr("--templates"));
  EXPECT_EQ(corvid_run({"bench", "ncc", "--device", "99"}).code, 5);
}

TEST_F(BenchTest, AFileThatCannotBeWrittenIsFoundOutBeforeMeasuring) {
  const std::string fifo = path("a_fifo"), link = path("a_link");
  ASSERT_EQ(mkfifo(fifo.c_str(), 0600), 0);
  std::filesystem::create_symlink("a_fifo", link);
  const std::string below = write("a_file", "x") + "/ncc.json";
  for (const auto& [file, said] :
       {std::pair{below, "a_file"}, {fifo, "a_fifo"}, {link, "a_link"}}) {
    const Ran ran = corvid_run({"bench", "ncc", "--json", file});
    EXPECT_EQ(ran.code, 2) << file;
    EXPECT_THAT(ran.err, AllOf(HasSubstr("error: "), HasSubstr(said)));
    EXPECT_THAT(ran.err, Not(HasSubstr("preparing"))) << "measured before";
    EXPECT_THAT(ran.out, IsEmpty());
  }
}

TEST_F(BenchTest, SigintKeepsTheFinishedRowsAndEndsWith130) {
  SignallingBuffer buffer("dense: ");  // the line of the first row
  std::ostringstream out;
  std::ostream err(&buffer);
  const std::string file = path("ncc.json");
  // The second row would take an hour.
  const char* argv[] = {"corvid", "bench", "ncc",      "--tables", "dense",  "--templates", "3",
                        "--runs", "2000",  "--images", "64,3000",  "--json", file.c_str()};
  const int code = run_program(static_cast<int>(std::size(argv)), argv, Context{out, err});
  EXPECT_EQ(code, 130) << buffer.str();
  EXPECT_THAT(buffer.str(), HasSubstr("what there is will be saved"));
  const json rows = json::parse(read(file));
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0]["image_px"], 64);
  EXPECT_THAT(out.str(), HasSubstr("3x3"));
}

constexpr const char* kFlight = "synthetic:duration=0.75,rate=4,width=320,height=240,seed=2";

TEST_F(BenchTest, MatchingIsMeasuredAgainstSift) {
  const std::string file = path("matching.json");
  const Ran ran = corvid_run({"bench", "matching", kFlight, "--json", file});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.err, HasSubstr("pair 3 of 3"));
  EXPECT_THAT(ran.out, AllOf(HasSubstr("load average"), HasSubstr(kFlight),
                             HasSubstr("3 images of 320x240, 3 pairs"), HasSubstr("2-d matches")));
  const json rows = json::parse(read(file));
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0]["set"], kFlight);
  EXPECT_EQ(rows[0]["pairs"], 3);
  for (const char* key :
       {"sift_matches", "corvid_matches", "sift_points", "corvid_points", "sift_mse_px2",
        "corvid_mse_px2", "sift_truth_px", "corvid_truth_px", "sift_ms", "corvid_ms"})
    EXPECT_GT(rows[0].at(key), 0) << key;
}

TEST_F(BenchTest, TrackingIsTimedAndComparedWithTheTruth) {
  const std::string file = path("tracking.json");
  const std::string flight = "synthetic:duration=0.6,rate=20,width=320,height=240,seed=2";
  const Ran ran =
      corvid_run({"bench", "tracking", flight, kFlight, "--tracks", "150", "--json", file});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, AllOf(HasSubstr("load average"), HasSubstr(flight), HasSubstr(kFlight)));
  const json rows = json::parse(read(file));
  ASSERT_EQ(rows.size(), 2U) << "one per source";
  EXPECT_EQ(rows[0]["set"], flight);
  EXPECT_EQ(rows[0]["frames"], 12);
  EXPECT_EQ(rows[1]["frames"], 3);
  for (const json& row : rows) {
    EXPECT_EQ(row["max_tracks"], 150);
    EXPECT_GT(row["median_ms"], 0);
    EXPECT_GT(row["tracks"], 50);
    EXPECT_LE(row["tracks"], 150);
  }
}

TEST_F(BenchTest, SigintKeepsTheMatchesSoFar) {
  SignallingBuffer buffer("pair 2 of");
  std::ostringstream out;
  std::ostream err(&buffer);
  const std::string file = path("matching.json");
  std::vector<const char*> argv{"corvid", "bench", "matching", "--json", file.c_str()};
  argv.insert(argv.end(), 12, kFlight);  // the signal comes in the first of them
  const int code = run_program(static_cast<int>(argv.size()), argv.data(), Context{out, err});
  EXPECT_EQ(code, 130) << buffer.str();
  const json rows = json::parse(read(file));
  ASSERT_GE(rows.size(), 1U);
  EXPECT_LT(rows.size(), 12U);
  EXPECT_GE(rows[0]["pairs"], 2);
  EXPECT_THAT(out.str(), HasSubstr("2-d matches"));
}

}  // namespace
}  // namespace corvid
