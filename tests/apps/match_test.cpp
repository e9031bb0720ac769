#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "frontend/epipolar.h"
#include "io/calibration.h"
#include "io/image_encode.h"
#include "io/image_file.h"
#include "program_fixture.h"
#include "replay/synthetic_flight.h"
#include "scenes/flight_of.h"

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr char kFlight[] = "synthetic:width=376,height=240,seed=3,duration=0.5";
constexpr int kReference = 3, kTarget = 7, kAuxiliary = 5;

struct Row {
  Eigen::Vector2d x_r, x_t;
  double score = 0;
  Eigen::Matrix2d covariance_px2;
};

class MatchTest : public ProgramTest {
 protected:
  // kFlight's frames as files, with their camera.
  void write_frames() {
    FlightOptions options = scenes::flight_of(376, 240, 0.5);
    options.seed = 3;
    flight_ = std::make_unique<SyntheticFlight>(options);
    for (const int i : {kReference, kTarget, kAuxiliary}) {
      write(fmt::format("{}.png", i),
            encode_png(flight_->render(static_cast<std::size_t>(i))->grey));
    }
    const auto written =
        write_calibration(path("camera.yaml"), flight_->camera(), CalibrationFormat::opencv);
    ASSERT_TRUE(written) << written.error().to_string();
  }

  [[nodiscard]] std::vector<Row> rows(const std::string& name) const {
    std::istringstream text(read(path(name)));
    std::string line;
    std::getline(text, line);
    EXPECT_EQ(line, "x_r,y_r,x_t,y_t,score,covariance_xx,covariance_xy,covariance_yy");
    std::vector<Row> rows;
    while (std::getline(text, line)) {
      std::vector<double> v;
      std::istringstream cells(line);
      for (std::string cell; std::getline(cells, cell, ',');) v.push_back(std::stod(cell));
      if (v.size() != 8) {
        ADD_FAILURE() << line;
        continue;
      }
      rows.push_back(
          {{v[0], v[1]}, {v[2], v[3]}, v[4], Eigen::Matrix2d{{v[5], v[6]}, {v[6], v[7]}}});
    }
    return rows;
  }

  // Where the truth puts a pixel of the reference in the target.
  [[nodiscard]] std::optional<Eigen::Vector2d> true_place(const FloatImage& depth,
                                                          const Eigen::Vector2d& x_r) const {
    const float z =
        depth(static_cast<int>(std::lround(x_r.x())), static_cast<int>(std::lround(x_r.y())));
    const auto ray = flight_->camera().unproject(x_r);
    if (z <= 0 || !ray) return std::nullopt;
    const Eigen::Vector3d p = *ray * (static_cast<double>(z) / ray->z());
    return flight_->camera().project(flight_->true_pose(kTarget).inverse() *
                                     (flight_->true_pose(kReference) * p));
  }

  std::unique_ptr<SyntheticFlight> flight_;
};

Eigen::Matrix3d matrix(const json& rows) {
  Eigen::Matrix3d m;
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) m(i, k) = rows.at(i).at(k).get<double>();
  return m;
}

std::vector<std::string> modules_of(const json& report) {
  std::vector<std::string> names;
  for (const json& run : report["modules"]) names.push_back(run["module"]);
  return names;
}

TEST_F(MatchTest, TwoFramesGiveMatchesGeometryTableAndPicture) {
  write_frames();
  const Ran ran =
      corvid_run({"match", path("3.png"), path("7.png"), "--calibration", path("camera.yaml"),
                  "--out", path("pair.png"), "--matches", path("m.csv"), "--json", path("m.json")});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, AllOf(HasSubstr("3.png: 376x240 px, intrinsics from calibration"),
                             HasSubstr("round"), HasSubstr("rejected"), HasSubstr("unique"),
                             HasSubstr("fundamental matrix"), HasSubstr("highest scores"),
                             HasSubstr("ambiguous"), HasSubstr("step"), HasSubstr("pair.png")));
  const json report = json::parse(read(path("m.json")));
  const std::vector<Row> matches = rows("m.csv");
  EXPECT_GT(matches.size(), 300U);
  EXPECT_EQ(report["matches"], matches.size());
  std::size_t all = matches.size();
  for (const auto& [reason, count] : report["unmatched"].items()) all += count.get<std::size_t>();
  EXPECT_EQ(report["images"][0]["points"], all) << "every point has a match or a reason";
  EXPECT_EQ(report["images"][0]["role"], "reference");
  EXPECT_EQ(report["images"][1]["name"], "7.png");
  EXPECT_TRUE(report["refusal"].is_null());
  EXPECT_GT(report["timings"].size(), 3U);

  const Eigen::Matrix3d F = matrix(report["F"]);
  const FloatImage depth = flight_->render_depth(kReference);
  std::size_t compared = 0, wrong = 0;
  for (const Row& m : matches) {
    EXPECT_LT(sampson_distance_px(F, m.x_r, m.x_t), 1.0);
    EXPECT_LE(m.score, 1.001);
    EXPECT_GT(m.covariance_px2.determinant(), 0);
    if (const auto place = true_place(depth, m.x_r)) {
      ++compared;
      if ((*place - m.x_t).norm() > 3) ++wrong;
    }
  }
  EXPECT_GT(compared, 300U);
  EXPECT_LT(wrong, compared / 20);

  const auto picture = read_image(path("pair.png"));
  ASSERT_TRUE(picture) << picture.error().to_string();
  EXPECT_GE(picture->grey.width(), 4 * 376) << "small images are enlarged";
  EXPECT_LE(picture->grey.width(), 2400);
  EXPECT_GT(picture->grey.height(), 2 * 240);
  EXPECT_FALSE(picture->colour.empty());
}

TEST_F(MatchTest, FramesOfASourceAreTheSameImages) {
  write_frames();
  const std::string numbers = fmt::format("{},{}", kReference, kTarget);
  ASSERT_EQ(corvid_run({"match", path("3.png"), path("7.png"), "--calibration", path("camera.yaml"),
                        "--no-picture", "--matches", path("files.csv")})
                .code,
            0);
  const Ran frames = corvid_run({"match", kFlight, "--frames", numbers, "--marks", "lines", "--out",
                                 path("lines.jpg"), "--matches", path("frames.csv")});
  ASSERT_EQ(frames.code, 0) << frames.err;
  EXPECT_EQ(read(path("frames.csv")), read(path("files.csv")));
  EXPECT_TRUE(read_image(path("lines.jpg")));
  ASSERT_EQ(corvid_run({"record", kFlight, "--out", path("town"), "--grey"}).code, 0);
  const Ran folder = corvid_run({"match", path("town"), "--frames", numbers, "--no-picture",
                                 "--matches", path("folder.csv")});
  ASSERT_EQ(folder.code, 0) << folder.err;
  EXPECT_EQ(read(path("folder.csv")), read(path("files.csv")));
}

TEST_F(MatchTest, ModulesCanBeLeftOut) {
  const std::vector<std::string> base = {"match", kFlight, "--frames", "3,7", "--no-picture"};
  const auto with = [&](std::vector<std::string> more, const std::string& name) {
    more.insert(more.begin(), base.begin(), base.end());
    more.insert(more.end(), {"--json", path(name)});
    const Ran ran = corvid_run(more);
    EXPECT_EQ(ran.code, 0) << ran.err;
    return json::parse(read(path(name)));
  };
  const auto all = modules_of(with({}, "all.json"));
  EXPECT_THAT(all, AllOf(Contains("highest scores"), Contains("epipolar constraint")));
  const auto fewer = modules_of(with({"--without", "highest_scores,sectors"}, "fewer.json"));
  EXPECT_THAT(fewer, AllOf(Not(Contains("highest scores")), Contains("epipolar constraint"),
                           Not(Contains("epipolar sectors"))));
  EXPECT_EQ(modules_of(with({"--set", "matching.disambiguation.highest_scores=false", "--set",
                             "matching.disambiguation.sectors=false"},
                            "set.json")),
            fewer)
      << "the same as the option";
  const json few = with({"--max-points", "200"}, "few.json");
  EXPECT_LE(few["images"][0]["points"], 200);
}

TEST_F(MatchTest, AThirdImageIsMatchedFirst) {
  write_frames();
  const Ran ran = corvid_run({"match", path("3.png"), path("7.png"), path("5.png"), "--calibration",
                              path("camera.yaml"), "--no-picture", "--json", path("m.json"),
                              "--matches", path("m.csv")});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, HasSubstr("auxiliary    5.png"));
  const json report = json::parse(read(path("m.json")));
  ASSERT_EQ(report["images"].size(), 3U);
  EXPECT_EQ(report["images"][2]["role"], "auxiliary");
  EXPECT_GT(report["images"][2]["matches"], 300);
  const Eigen::Matrix3d F = matrix(report["F"]);
  const auto matches = rows("m.csv");
  EXPECT_GT(matches.size(), 300U);
  for (const Row& m : matches) EXPECT_LT(sampson_distance_px(F, m.x_r, m.x_t), 1.0);
}

GreyImage noise(unsigned seed) {
  std::mt19937 random(seed);
  GreyImage image(300, 200);
  for (std::size_t i = 0; i < image.size(); ++i)
    image.data()[i] = static_cast<std::uint8_t>(random() >> 24);
  return image;
}

TEST_F(MatchTest, WhatShowsNothingInCommonHasNoGeometry) {
  write("black.png", encode_png(GreyImage(300, 200)));
  write("noise_a.png", encode_png(noise(1)));
  write("noise_b.png", encode_png(noise(2)));
  const std::vector<std::pair<const char*, const char*>> pairs = {
      {"black.png", "black.png"}, {"noise_a.png", "noise_b.png"}, {"noise_a.png", "black.png"}};
  for (const auto& [a, b] : pairs) {
    const Ran ran = corvid_run({"match", path(a), path(b), "--out", path("p.png"), "--matches",
                                path("m.csv"), "--json", path("m.json")});
    EXPECT_EQ(ran.code, static_cast<int>(ExitCode::no_estimate)) << a << " " << b;
    EXPECT_THAT(ran.err, HasSubstr("no common geometry: "));
    EXPECT_THAT(ran.out, AllOf(HasSubstr("none: no common geometry: "), Not(HasSubstr("nan"))));
    EXPECT_THAT(rows("m.csv"), IsEmpty());
    const json report = json::parse(read(path("m.json")));
    EXPECT_TRUE(report["F"].is_null());
    EXPECT_EQ(report["matches"], 0);
    EXPECT_THAT(report["refusal"].get<std::string>(), Not(IsEmpty()));
    EXPECT_TRUE(read_image(path("p.png"))) << "the picture shows why";
    std::filesystem::remove(path("p.png"));
  }
}

TEST_F(MatchTest, WrongInputsAreNamed) {
  write("noise.png", encode_png(noise(1)));
  write("tiny.png", encode_png(GreyImage(40, 20)));
  write("empty.png", "");
  write("text.png", "not an image");
  write("camera.txt", "nothing");
  const std::string good = path("noise.png");
  struct Case {
    std::vector<std::string> arguments;
    ExitCode code;
    const char* said;
  };
  const Case cases[] = {
      {{}, ExitCode::usage, "IMAGE is required"},
      {{good}, ExitCode::usage, "a second image is missing"},
      {{path("absent.png"), good}, ExitCode::not_found, "absent.png"},
      {{good, path("tiny.png")}, ExitCode::bad_input, "40 x 20 pixels: too small"},
      {{good, path("empty.png")}, ExitCode::bad_input, "empty.png"},
      {{good, path("text.png")}, ExitCode::bad_input, "text.png"},
      {{good, folder_.string()}, ExitCode::bad_input, "this is a folder"},
      {{good, good, "--calibration", path("none")}, ExitCode::not_found, "none"},
      {{good, good, "--calibration", path("camera.txt")}, ExitCode::bad_input, "camera.txt"},
      {{good, good, "--marks", "crosses"}, ExitCode::usage, "crosses"},
      {{good, good, "--without", "unique"}, ExitCode::usage, "unique"},
      {{good, good, "--max-points", "3"}, ExitCode::usage, "matching.max_points"},
      {{good, good, "--set", "matching.max_point=9"}, ExitCode::usage, "matching.max_points?"},
      {{good, good, "--out", path("x.gif")}, ExitCode::usage, "PNG or JPEG"},
      {{good, good, "--out", good}, ExitCode::usage, "is an image or an output already"},
      {{good, good, "--matches", path("x"), "--json", path("./x")},
       ExitCode::usage,
       "is an image or an output already"},
      {{good, good, "--json", folder_.string()}, ExitCode::usage, "is a folder"},
      {{kFlight, "--frames", "3"}, ExitCode::usage, "at least two numbers"},
      {{kFlight, "--frames", "3,-1"}, ExitCode::usage, "--frames: must be at least 0, not -1"},
      {{kFlight, "--frames", "3,4000"}, ExitCode::usage, "no frame 4000 among"},
      {{kFlight, good, "--frames", "3,4"}, ExitCode::usage, "takes one source"},
      {{"synthetic:width=64,height=24", "--frames", "0,1"}, ExitCode::bad_input, "too small"},
      {{good, good, "--device", "99"}, ExitCode::device, "99"},
  };
  for (const Case& c : cases) {
    std::vector<std::string> arguments = {"match"};
    arguments.insert(arguments.end(), c.arguments.begin(), c.arguments.end());
    if (std::find(arguments.begin(), arguments.end(), "--out") == arguments.end())
      arguments.emplace_back("--no-picture");
    const Ran ran = corvid_run(arguments);
    EXPECT_EQ(ran.code, static_cast<int>(c.code)) << c.said << ": " << ran.err;
    EXPECT_THAT(ran.err, AllOf(HasSubstr("error: "), HasSubstr(c.said)));
    EXPECT_THAT(ran.out, IsEmpty()) << c.said;
  }
  EXPECT_TRUE(read_image(good)) << "no input was written over";
}

TEST_F(MatchTest, ImagesMayDifferInSize) {
  write_frames();
  const GreyImage whole = flight_->render(kTarget)->grey;
  GreyImage part(300, 240);  // its left side: calibrations fit whole images only
  for (int y = 0; y < part.height(); ++y)
    for (int x = 0; x < part.width(); ++x) part(x, y) = whole(x, y);
  write("part.png", encode_png(part));
  const Ran ran = corvid_run({"match", path("3.png"), path("part.png"), "--out", path("p.png"),
                              "--matches", path("m.csv")});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.err, HasSubstr("part.png: no calibration and no focal length in EXIF"));
  EXPECT_THAT(ran.out, HasSubstr("300x240 px, intrinsics from guess"));
  EXPECT_GT(rows("m.csv").size(), 200U);
  EXPECT_TRUE(read_image(path("p.png")));
}

}  // namespace
}  // namespace corvid
