#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>

#include "io/image_encode.h"
#include "io/mesh_files.h"
#include "program_fixture.h"
#include "scenes/ball_views.h"

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::Not;

class MvsTest : public ProgramTest {
 protected:
  /// A folder as Middlebury's sets are; with `volume` its README names the box around the ball.
  std::string stills(int count, bool volume) const {
    const std::string folder = path("stills");
    std::filesystem::create_directories(folder);
    std::string lines = std::to_string(count) + "\n";
    for (const StillView& view : testing::ball_views(count)) {
      const std::string name = "v" + std::to_string(view.frame->id.value) + ".png";
      write("stills/" + name, encode_png(view.frame->grey));
      lines += testing::middlebury_line(name, view);
    }
    write("stills/ball_par.txt", lines);
    if (volume) {
      write("stills/README.txt", "a tight bounding box:\n(-0.9 -0.9 2.1)\n(0.9 0.9 3.0)\n");
    }
    return folder;
  }
};

TEST_F(MvsTest, DepthMapsPointsSurfaceAndReport) {
  const Ran ran = corvid_run({"mvs", stills(7, true), "--out", path("out"), "--voxel", "0.04"});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, HasSubstr("7 depth maps of 7 views"));
  EXPECT_THAT(ran.out, HasSubstr("surface.ply"));
  EXPECT_TRUE(std::filesystem::exists(path("out/depth/view_0003.pfm")));
  EXPECT_TRUE(std::filesystem::exists(path("out/depth/view_0003_depth.png")));
  EXPECT_TRUE(std::filesystem::exists(path("out/depth/view_0003_confidence.png")));
  const json numbers = json::parse(read(path("out/mvs.json")));
  EXPECT_EQ(numbers["views"].size(), 7U);
  EXPECT_EQ(numbers["surface"]["unpaired_sides"], 0);
  EXPECT_NEAR(numbers["surface"]["voxel_size"], 0.04, 1e-9);
  const auto surface = read_mesh(path("out/surface.ply"));
  ASSERT_TRUE(surface.has_value()) << surface.error().to_string();
  EXPECT_EQ(surface->triangles.size(), numbers["surface"]["triangles"]);
  const auto points = read_mesh(path("out/points.ply"));
  ASSERT_TRUE(points.has_value()) << points.error().to_string();
  EXPECT_EQ(points->vertices.size(), numbers["points"]);
  const std::string page = read(path("out/report.html"));
  EXPECT_THAT(page, HasSubstr("maximum flow"));
  EXPECT_THAT(page, HasSubstr("As the first view with depth saw it"));
}

TEST_F(MvsTest, WithoutASurfaceOnRequest) {
  const Ran ran = corvid_run({"mvs", stills(5, false), "--out", path("out"), "--no-surface"});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_FALSE(std::filesystem::exists(path("out/surface.ply")));
  EXPECT_TRUE(json::parse(read(path("out/mvs.json")))["surface"].is_null());
  EXPECT_THAT(read(path("out/report.html")), HasSubstr("None was asked for"));
}

TEST_F(MvsTest, ASurfaceThatCannotBeIsSaidAndTheRestIsKept) {
  const std::string folder = stills(5, false);
  // A volume where nothing is.
  write("stills/README.txt", "a tight bounding box:\n(50 50 50)\n(51 51 51)\n");
  const Ran ran = corvid_run({"mvs", folder, "--out", path("out")});
  EXPECT_EQ(ran.code, 6);
  EXPECT_THAT(ran.out, Not(HasSubstr("surface")));
  EXPECT_THAT(ran.err, HasSubstr("no surface"));
  EXPECT_TRUE(std::filesystem::exists(path("out/points.ply")));
  EXPECT_THAT(json::parse(read(path("out/mvs.json")))["surface"]["refusal"].get<std::string>(),
              HasSubstr("has a point in the volume"));
}

TEST_F(MvsTest, OpenLeavesOutWhatNoPointSupports) {
  const std::string folder = stills(5, true);
  const Ran ran = corvid_run({"mvs", folder, "--out", path("out"), "--voxel", "0.04", "--open"});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_GT(json::parse(read(path("out/mvs.json")))["surface"]["unpaired_sides"], 0);
}

TEST_F(MvsTest, WithoutDepthThereIsNoSurfaceAndTheReasonIsThere) {
  const Ran ran = corvid_run(
      {"mvs", stills(3, false), "--out", path("out"), "--near", "1000", "--far", "2000"});
  EXPECT_EQ(ran.code, 6) << ran.err;
  EXPECT_THAT(ran.out, HasSubstr("0 depth maps of 3 views"));
  EXPECT_THAT(read(path("out/report.html")), Not(HasSubstr("None was asked for")));
  EXPECT_THAT(json::parse(read(path("out/mvs.json")))["surface"]["refusal"].get<std::string>(),
              HasSubstr("no view has depth"));
}

TEST_F(MvsTest, UnreadableImagesAreNamed) {
  const std::string folder = stills(6, false);
  write("stills/v2.png", "no picture");
  const Ran ran = corvid_run({"mvs", folder, "--out", path("out"), "--no-surface"});
  EXPECT_EQ(ran.code, 0);
  EXPECT_THAT(ran.err, HasSubstr("skipped: "));
  EXPECT_THAT(ran.err, HasSubstr("v2.png"));
}

TEST_F(MvsTest, SigintLeavesNoPartialFolder) {
  const std::string folder = stills(5, false), out_folder = path("out");
  for (const char* moment : {"Middlebury", "depth of view 2"}) {
    SignallingBuffer buffer(moment);
    std::ostream err(&buffer);
    std::ostringstream out;
    const char* argv[] = {"corvid", "mvs", folder.c_str(), "--out", out_folder.c_str()};
    EXPECT_EQ(run_program(5, argv, Context{out, err}), 130) << buffer.str();
    EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder_), {}), 1) << moment;
  }
}

TEST_F(MvsTest, SigintDuringTheCutKeepsTheDepthMaps) {
  const std::string folder = stills(5, true), out_folder = path("out");
  SignallingBuffer buffer("cutting the surface");
  std::ostream err(&buffer);
  std::ostringstream out;
  const char* argv[] = {"corvid", "mvs", folder.c_str(), "--out", out_folder.c_str()};
  EXPECT_EQ(run_program(5, argv, Context{out, err}), 130) << buffer.str();
  EXPECT_TRUE(std::filesystem::exists(path("out/depth/view_0003.pfm")));
  EXPECT_FALSE(std::filesystem::exists(path("out/surface.ply")));
}

TEST_F(MvsTest, WrongInputsAreNamed) {
  const std::string folder = stills(5, false);
  EXPECT_EQ(corvid_run({"mvs", folder}).code, 2);
  EXPECT_EQ(corvid_run({"mvs", folder, "--out", path("o"), "--voxel", "-1"}).code, 2);
  const Ran near = corvid_run({"mvs", folder, "--out", path("o"), "--near", "2"});
  EXPECT_EQ(near.code, 2);
  EXPECT_THAT(near.err, HasSubstr("--near, --far"));
  const Ran absent = corvid_run({"mvs", path("nothing"), "--out", path("o")});
  EXPECT_EQ(absent.code, 3);
  EXPECT_THAT(absent.err, HasSubstr("nothing"));
  std::filesystem::remove(path("stills/ball_par.txt"));
  const Ran unposed = corvid_run({"mvs", folder, "--out", path("o")});
  EXPECT_EQ(unposed.code, 4);
  EXPECT_THAT(unposed.err, HasSubstr("no image has a pose"));
  EXPECT_FALSE(std::filesystem::exists(path("o")));
}

}  // namespace
}  // namespace corvid
