#include <gmock/gmock.h>

#include <chrono>
#include <thread>

#include "apps/live_folder.h"
#include "apps/program_fixture.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class LiveFolderTest : public ProgramTest {
 protected:
  /// A flight with `camera`'s one picture that must end with an error and leave nothing.
  [[nodiscard]] Ran refused(const std::vector<std::string>& more) const {
    std::vector<std::string> words = {
        "live", "--camera",
        "y4m:" + write("flight.y4m", "YUV4MPEG2 W64 H48 F10:1 Cmono\nFRAME\n" +
                                         std::string(std::size_t{64} * 48, 'x')),
        "--no-mapping"};
    words.insert(words.end(), more.begin(), more.end());
    return corvid_run(words);
  }
};

TEST_F(LiveFolderTest, AFolderThatIsNotOursIsRefusedBeforeAnythingIsMade) {
  fs::create_directory(path("home"));
  write("home/letter", "dear");
  const Ran ran = refused({"--out", path("home"), "--record", path("rec.mkv")});
  EXPECT_EQ(ran.code, 2);
  EXPECT_THAT(ran.err, HasSubstr("choose another output folder"));
  EXPECT_FALSE(fs::exists(path("home.live")));
  EXPECT_FALSE(fs::exists(path("rec.mkv")));
  EXPECT_FALSE(fs::exists(path("rec.times.csv")));
  EXPECT_EQ(read(path("home/letter")), "dear");
}

TEST_F(LiveFolderTest, AFlightThatDoesNotBeginLeavesNone) {
  const Ran ran = refused({"--out", path("run"), "--device", "99"});
  EXPECT_NE(ran.code, 0);
  EXPECT_THAT(ran.err, HasSubstr("99"));
  EXPECT_FALSE(fs::exists(path("run.live")));
  EXPECT_FALSE(fs::exists(path("run")));
}

TEST_F(LiveFolderTest, PosesAndMapAreThereBeforeTheEndWhenItHurries) {
  auto made = LiveFolder::create(path("run"), "a test");
  ASSERT_TRUE(made) << made.error().to_string();
  const std::unique_ptr<LiveFolder> folder = std::move(*made);
  PoseEvent event;
  event.T_world_camera = Pose();
  for (event.time_ns = 1; event.time_ns <= 3; ++event.time_ns) folder->on_pose(event);
  folder->on_map(std::make_shared<MapSnapshot>());
  folder->hurry();
  // Written in the order lines, keyframes, points; the map's usual interval is half a minute.
  for (int i = 0; i < 2000 && !fs::exists(folder->path() / "points.ply"); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_TRUE(fs::exists(folder->path() / "points.ply"));
  EXPECT_TRUE(fs::exists(folder->path() / "keyframes.txt"));
  const auto poses = read_trajectory((folder->path() / "poses.txt").string());
  ASSERT_TRUE(poses) << poses.error().to_string();
  EXPECT_EQ(poses->size(), 3U);
  // A line that a kill has torn is none.
  std::ofstream(folder->path() / "poses.txt", std::ios::app) << "0.000000004 1 2 3 0 0 0 0.9";
  EXPECT_EQ(read_trajectory((folder->path() / "poses.txt").string())->size(), 3U);
  // The next run has a folder of its own.
  auto second = LiveFolder::create(path("run"), "another");
  ASSERT_TRUE(second);
  EXPECT_NE((*second)->path(), folder->path());
  folder->remove();
  EXPECT_FALSE(fs::exists(folder->path()));
}

}  // namespace
}  // namespace corvid
