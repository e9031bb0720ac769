#include "apps/run_folder.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "io/atomic_file.h"
#include "io/mesh_files.h"
#include "io/options_file.h"
#include "io/trajectory_file.h"
#include "scenes/run_results.h"
#include "scenes/temporary_folder.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;

RunReportInput input_of(const RunResult& run) {
  return {run, std::nullopt, std::nullopt, "1.2.3", "corvid replay x --out y"};
}

nlohmann::json json_of(const fs::path& path) {
  return nlohmann::json::parse(read_file_bytes(path).value());
}

TEST(RunFolder, HoldsEverything) {
  const TemporaryFolder folder;
  const fs::path dir = folder / "run";
  const RunResult run = made_up_run();
  ASSERT_TRUE(check_run_folder(dir));
  EXPECT_FALSE(fs::exists(dir));
  const auto written = write_run_folder(input_of(run), dir);
  ASSERT_TRUE(written) << written.error().to_string();
  for (const char* name :
       {"trajectory.txt", "keyframes.txt", "points.ply", "mesh.drc", "mesh.glb", "options.yaml",
        "run.json", "report.html", "colmap/sparse/images.txt", "depth/index.json"}) {
    EXPECT_TRUE(fs::is_regular_file(dir / name)) << name;
  }
  const auto trajectory = read_trajectory((dir / "trajectory.txt").string());
  ASSERT_TRUE(trajectory) << trajectory.error().to_string();
  EXPECT_EQ(trajectory->size(), run.trajectory.size());
  EXPECT_EQ(trajectory->front().time_ns, run.trajectory.front().time_ns);

  const auto points = read_mesh(dir / "points.ply");
  ASSERT_TRUE(points);
  EXPECT_EQ(points->vertices.size(), run.map->landmarks.size());
  EXPECT_EQ(points->colours[5], std::next(run.map->landmarks.begin(), 5)->colour);

  const auto mesh = load_run_mesh(dir);
  ASSERT_TRUE(mesh) << mesh.error().to_string();
  EXPECT_EQ(mesh->triangles.size(), run.mesh.triangles.size());
  EXPECT_NEAR(signed_volume(*mesh), signed_volume(run.mesh), 0.002 * signed_volume(run.mesh));

  const auto options = read_options_file(dir / "options.yaml");
  ASSERT_TRUE(options) << options.error().to_string();
  EXPECT_EQ(options_to_yaml(*options), options_to_yaml(run.options));

  const auto index = json_of(dir / "depth" / "index.json");
  ASSERT_EQ(index.size(), run.depth_maps.size());
  for (const auto& entry : index) {
    EXPECT_TRUE(fs::is_regular_file(dir / "depth" / entry.at("depth").get<std::string>()));
  }
  const auto json = json_of(dir / "run.json");
  for (const auto& name : json.at("files")) EXPECT_TRUE(fs::exists(dir / name.get<std::string>()));
  EXPECT_EQ(json.at("colmap").size(), 2u);  // two segments

  // Nothing is left beside it, and nothing temporary in it.
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), {}), 1);
  for (const auto& entry : fs::recursive_directory_iterator(dir)) {
    EXPECT_EQ(entry.path().string().find(".partial-"), std::string::npos) << entry.path();
  }
}

TEST(RunFolder, KeyframesAreTumRowsWithMoreBehind) {
  const TemporaryFolder folder;
  const RunResult run = made_up_run();
  ASSERT_TRUE(write_run_folder(input_of(run), folder / "run"));
  std::ifstream file(folder / "run" / "keyframes.txt");
  std::string line;
  ASSERT_TRUE(std::getline(file, line));
  EXPECT_TRUE(line.starts_with("#"));
  std::size_t rows = 0;
  for (; std::getline(file, line); ++rows) {
    std::istringstream row(line);
    std::string time;
    double v[7];
    std::uint32_t keyframe = 0, frame = 0;
    row >> time;
    for (double& x : v) row >> x;
    row >> keyframe >> frame;
    ASSERT_TRUE(row) << line;
    const Keyframe& expected = *run.map->keyframes[rows];
    EXPECT_EQ(keyframe, expected.id.value);
    EXPECT_EQ(frame, expected.frame->id.value);
    EXPECT_EQ(v[0], expected.T_world_camera.translation().x());
    EXPECT_EQ(v[6], expected.T_world_camera.rotation().w());
    std::string digits = time;
    digits.erase(digits.find('.'), 1);
    EXPECT_EQ(std::stoll(digits), expected.frame->time_ns);
  }
  EXPECT_EQ(rows, run.map->keyframes.size());
}

TEST(RunFolder, RawDepthIsAPortableFloatMap) {
  const TemporaryFolder folder;
  RunResult run = made_up_run();
  run.depth_maps.erase(run.depth_maps.begin() + 1, run.depth_maps.end());
  ASSERT_TRUE(write_run_folder(input_of(run), folder / "run"));
  const std::string bytes =
      read_file_bytes(folder / "run" / "depth" / "keyframe_000000.pfm").value();
  const std::string header = "Pf\n320 240\n-1.0\n";
  ASSERT_EQ(bytes.size(), header.size() + 320 * 240 * 4);
  EXPECT_TRUE(bytes.starts_with(header));
  float bottom_left = -1, centre = -1;
  std::memcpy(&bottom_left, bytes.data() + header.size(), 4);
  std::memcpy(&centre, bytes.data() + header.size() + 4 * ((239 - 120) * 320 + 161), 4);
  EXPECT_EQ(bottom_left, run.depth_maps[0].load().depth(0, 239));
  EXPECT_EQ(centre, run.depth_maps[0].load().depth(161, 120));
}

TEST(RunFolder, TheCutSurfaceHasFilesOfItsOwn) {
  const TemporaryFolder folder;
  const RunResult run = made_up_run();
  SurfaceCut cut;
  cut.mesh = run.mesh;
  cut.mesh.triangles.resize(cut.mesh.triangles.size() / 2);
  cut.voxel_size = 0.1;
  RunReportInput input = input_of(run);
  input.cut = &cut;
  ASSERT_TRUE(write_run_folder(input, folder / "both"));
  EXPECT_TRUE(fs::is_regular_file(folder / "both" / "mesh-cut.glb"));
  EXPECT_EQ(load_run_mesh(folder / "both", RunSurface::cut)->triangles.size(),
            cut.mesh.triangles.size());
  EXPECT_EQ(load_run_mesh(folder / "both")->triangles.size(), run.mesh.triangles.size());
  input.live_surface = false;
  ASSERT_TRUE(write_run_folder(input, folder / "cut"));
  EXPECT_FALSE(fs::exists(folder / "cut" / "mesh.drc"));
  EXPECT_FALSE(load_run_mesh(folder / "cut", RunSurface::cut)->empty());
  ASSERT_TRUE(write_run_folder(input_of(run), folder / "live"));
  EXPECT_TRUE(load_run_mesh(folder / "live", RunSurface::cut)->empty());
}

TEST(RunFolder, EmptyRunIsWrittenAndSaysSo) {
  const TemporaryFolder folder;
  RunResult run;
  run.interrupted = true;
  const auto written = write_run_folder(input_of(run), folder / "run");
  ASSERT_TRUE(written) << written.error().to_string();
  EXPECT_EQ(json_of(folder / "run" / "run.json").at("interrupted"), true);
  EXPECT_FALSE(fs::exists(folder / "run" / "mesh.drc"));
  EXPECT_FALSE(fs::exists(folder / "run" / "colmap"));
  const auto mesh = load_run_mesh(folder / "run");
  ASSERT_TRUE(mesh);
  EXPECT_TRUE(mesh->empty());
  EXPECT_EQ(copy_run_colmap(folder / "run", folder / "out").error().code, ErrorCode::not_found);
}

TEST(RunFolder, ReplacesARunAndRefusesAnythingElse) {
  const TemporaryFolder folder;
  const RunResult run = made_up_run(30);
  ASSERT_TRUE(write_run_folder(input_of(run), folder / "run"));
  ASSERT_TRUE(write_file_atomically(folder / "run" / "stale", "x"));
  ASSERT_TRUE(write_run_folder(input_of(run), folder / "run"));
  EXPECT_FALSE(fs::exists(folder / "run" / "stale"));

  ASSERT_TRUE(write_file_atomically(folder / "photos" / "a.jpg", "x"));
  for (const auto& refused :
       {check_run_folder(folder / "photos"), write_run_folder(input_of(run), folder / "photos")}) {
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::invalid_argument);
    EXPECT_NE(refused.error().to_string().find("photos"), std::string::npos);
  }
  EXPECT_EQ(read_file_bytes(folder / "photos" / "a.jpg").value(), "x");
  EXPECT_EQ(load_run_mesh(folder / "photos").error().code, ErrorCode::not_found);
}

TEST(RunFolder, ColmapModelIsCopied) {
  const TemporaryFolder folder;
  ASSERT_TRUE(write_run_folder(input_of(made_up_run()), folder / "run"));
  ASSERT_TRUE(copy_run_colmap(folder / "run", folder / "out"));
  EXPECT_TRUE(fs::is_regular_file(folder / "out" / "sparse" / "cameras.txt"));
  EXPECT_FALSE(fs::is_empty(folder / "out" / "images"));
  const auto again = copy_run_colmap(folder / "run", folder / "out");
  ASSERT_FALSE(again);
  EXPECT_EQ(again.error().code, ErrorCode::invalid_argument);
  EXPECT_NE(again.error().what.find("not empty"), std::string::npos);
}

TEST(RunFolder, ColmapModelThatCannotBeWrittenSaysWhy) {
  const TemporaryFolder folder;
  ASSERT_TRUE(write_run_folder(input_of(made_up_run()), folder / "run"));
  // An empty folder would be replaced, but the name of the partial one beside it is too long.
  const fs::path out = folder / std::string(252, 'o');
  ASSERT_TRUE(fs::create_directory(out));
  const auto copied = copy_run_colmap(folder / "run", out);
  ASSERT_FALSE(copied);
  EXPECT_EQ(copied.error().code, ErrorCode::io);
  EXPECT_EQ(copied.error().what.find("not empty"), std::string::npos) << copied.error().what;
}

TEST(RunFolder, KilledWriterLeavesNoHalfFolder) {
  const TemporaryFolder folder;
  const fs::path dir = folder / "run";
  const RunResult run = made_up_run(30);
  for (const int milliseconds : {20, 70, 150, 310}) {
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      while (true) (void)write_run_folder(input_of(run), dir);
    }
    ::usleep(static_cast<useconds_t>(milliseconds) * 1000);
    ::kill(child, SIGKILL);
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status));
    if (!fs::exists(dir)) continue;
    const auto json = json_of(dir / "run.json");
    for (const auto& name : json.at("files")) {
      EXPECT_TRUE(fs::exists(dir / name.get<std::string>())) << name;
    }
    const std::string html = read_file_bytes(dir / "report.html").value();
    EXPECT_TRUE(html.ends_with("</html>\n"));
  }
  ASSERT_TRUE(write_run_folder(input_of(run), dir));
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), {}), 1);  // no partial is left
}

}  // namespace
}  // namespace corvid
