#include <gmock/gmock.h>

#include "apps/program_fixture.h"

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

}  // namespace
}  // namespace corvid
