#include "io/trajectory_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "io/source_test_files.h"

namespace corvid {
namespace {

using test::TempFolder;
using test::write_text;
using testing::HasSubstr;

Trajectory random_trajectory(int count) {
  std::mt19937_64 rng(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  Trajectory result;
  std::int64_t time = 1'403'638'538'577'829'376;
  for (int i = 0; i < count; ++i) {
    Vector6d v;
    for (double& x : v) x = uniform(rng);
    v.head<3>() *= 1e5;
    result.push_back({time, Pose::exp(v)});
    time += 1 + static_cast<std::int64_t>(rng() % 100'000'000);
  }
  return result;
}

TEST(TrajectoryFile, TumRoundTripIsExact) {
  TempFolder t;
  Trajectory written = random_trajectory(200);
  written.insert(written.begin(), {-1'500'000'001, Pose()});
  written.insert(written.begin() + 1, {0, Pose()});
  ASSERT_TRUE(write_trajectory(t / "out/a.txt", written));
  const auto read = read_trajectory(t / "out/a.txt");
  ASSERT_TRUE(read) << read.error().to_string();
  ASSERT_EQ(read->size(), written.size());
  for (std::size_t i = 0; i < written.size(); ++i) {
    EXPECT_EQ((*read)[i].time_ns, written[i].time_ns);
    EXPECT_EQ((*read)[i].T_world_camera.translation(), written[i].T_world_camera.translation());
    EXPECT_LT(((*read)[i].T_world_camera.rotation().coeffs() -
               written[i].T_world_camera.rotation().coeffs())
                  .norm(),
              1e-15);
  }
}

TEST(TrajectoryFile, EmptyTrajectoryIsAnEmptyFile) {
  TempFolder t;
  ASSERT_TRUE(write_trajectory(t / "a.txt", {}));
  const auto read = read_trajectory(t / "a.txt");
  ASSERT_FALSE(read);
  EXPECT_THAT(read.error().to_string(), HasSubstr("no poses"));
}

TEST(TrajectoryFile, TumOrderAndTimes) {
  TempFolder t;
  write_text(t / "a.txt",
             "# x\n1305031102.1753 1 2 3 0.5 0.5 -0.5 0.5\r\n1305031102.2 1 2 3 0 0 0 1\n");
  const auto read = read_trajectory(t / "a.txt");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ((*read)[0].time_ns, 1305031102'175'300'000);
  EXPECT_EQ((*read)[0].T_world_camera.translation(), Eigen::Vector3d(1, 2, 3));
  EXPECT_NEAR((*read)[0].T_world_camera.rotation().z(), -0.5, 1e-15);
  EXPECT_NEAR((*read)[0].T_world_camera.rotation().w(), 0.5, 1e-15);
}

TEST(TrajectoryFile, EurocOrderAndTimes) {
  TempFolder t;
  write_text(t / "a.csv",
             "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z, v\n"
             "1403638538577829632,4,5,6,0.5,0.5,0.5,-0.5,9,9\n");
  const auto read = read_trajectory(t / "a.csv");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ((*read)[0].time_ns, 1403638538577829632);
  EXPECT_NEAR((*read)[0].T_world_camera.rotation().w(), 0.5, 1e-15);
  EXPECT_NEAR((*read)[0].T_world_camera.rotation().z(), -0.5, 1e-15);
  write_text(t / "b.csv", "timestamp,x,y,z,qw,qx,qy,qz\n7,4,5,6,1,0,0,0\n");
  ASSERT_TRUE(read_trajectory(t / "b.csv"));
}

TEST(TrajectoryFile, KittiTimes) {
  TempFolder t;
  const std::string rows = "1 0 0 1 0 1 0 2 0 0 1 3\n0 -1 0 4 1 0 0 5 0 0 1 6\n";
  write_text(t / "poses/07.txt", rows);
  auto read = read_trajectory(t / "poses/07.txt");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ((*read)[1].time_ns, 100'000'000);  // 10 Hz
  EXPECT_EQ((*read)[1].T_world_camera.translation(), Eigen::Vector3d(4, 5, 6));
  EXPECT_NEAR(((*read)[1].T_world_camera * Eigen::Vector3d(1, 0, 0)).y(), 6, 1e-12);

  write_text(t / "sequences/07/times.txt", "0.5\n1.038752e-01\n");  // does not rise: not taken
  EXPECT_EQ((*read_trajectory(t / "poses/07.txt"))[1].time_ns, 100'000'000);
  write_text(t / "sequences/07/times.txt", "0\n1.038752e-01\n2\n");
  EXPECT_EQ((*read_trajectory(t / "poses/07.txt"))[1].time_ns, 103'875'200);
  TrajectoryReadOptions options;
  options.times_path = t / "own.txt";
  write_text(t / "own.txt", "5\n");
  EXPECT_THAT(read_trajectory(t / "poses/07.txt", options).error().to_string(),
              HasSubstr("1 times for 2 poses"));
  write_text(t / "own.txt", "5\n6\n");
  EXPECT_EQ((*read_trajectory(t / "poses/07.txt", options))[0].time_ns, 5'000'000'000);
}

TEST(TrajectoryFile, FaultsNameTheirLine) {
  struct Case {
    const char *text, *expected;
  };
  TempFolder t;
  for (const Case& c : {
           Case{"1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0\n", ":2:"},
           Case{"1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 x\n", "\"x\" is not a finite number"},
           Case{"1 0 0 0 0 0 0 1\n2 0 inf 0 0 0 0 1\n", ":2:"},
           Case{"1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 0\n", "unit length"},
           Case{"2 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "does not rise"},
           Case{"2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "does not rise"},
           Case{"1e300 0 0 0 0 0 0 1\n", "not a time"},
           Case{"1 2 3\n", "3 columns"},
           Case{"1 0 0 1 0 1 0 2 0 0 1 3\n1 0 0 1 0 1 0 2 0 0 1\n", ":2:"},
           Case{"1 0 0 1 0 1 0 2 0 0 -1 3\n", "not a rotation"},
           Case{"", "no poses"},
       }) {
    write_text(t / "a.txt", c.text);
    const auto read = read_trajectory(t / "a.txt");
    ASSERT_FALSE(read) << c.text;
    EXPECT_EQ(read.error().code, ErrorCode::corrupt);
    EXPECT_THAT(read.error().to_string(), HasSubstr(c.expected));
  }
  EXPECT_EQ(read_trajectory(t / "absent.txt").error().code, ErrorCode::not_found);
}

}  // namespace
}  // namespace corvid
