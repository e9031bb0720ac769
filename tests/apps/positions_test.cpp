// Positions from a csv, through the whole program.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <iostream>
#include <nlohmann/json.hpp>
#include <random>

#include "core/geodesy.h"
#include "io/trajectory_file.h"
#include "program_fixture.h"
#include "replay/synthetic_flight.h"
#include "scenes/flight_of.h"

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

using PositionsTest = ProgramTest;

constexpr const char* kFlight =
    "synthetic:width=320,height=240,duration=8,rate=20,seed=2,path=orbit,speed=12";

SyntheticFlight flight() {
  FlightOptions options = scenes::flight_of(320, 240, 8);
  options.seed = 2;
  options.path = FlightPath::orbit;
  options.speed_mps = 12;
  return SyntheticFlight(options);
}

const LocalFrame& town() {
  static const LocalFrame frame({47.3977, 8.5456, 488});
  return frame;
}

/// The truth as a receiver at 10 Hz with 0.1 m of noise sees it; one fix in ten is far off.
std::string receiver_csv() {
  std::mt19937_64 random(8);
  std::normal_distribution<double> noise(0, 0.1);
  std::string text =
      "time_s,latitude_deg,longitude_deg,altitude_m,sigma_horizontal_m,sigma_vertical_m\n";
  const Trajectory truth = flight().truth();
  for (std::size_t i = 0; i < truth.size(); i += 2) {
    Eigen::Vector3d p = truth[i].T_world_camera.translation();
    p += Eigen::Vector3d(noise(random), noise(random), noise(random));
    if (random() % 10 == 0) p += Eigen::Vector3d(20, -30, 15);
    const GeodeticPosition g = to_geodetic(town().to_ecef(p));
    text += fmt::format("{:.9f},{:.10f},{:.10f},{:.4f},0.1,0.1\n", 1e-9 * double(truth[i].time_ns),
                        g.latitude_deg, g.longitude_deg, g.altitude_m);
  }
  return text;
}

TEST_F(PositionsTest, PutTheFlightOnEarth) {
  const std::string csv = write("gnss.csv", receiver_csv());
  const Ran ran = corvid_run({"replay", kFlight, "--out", path("run"), "--positions", csv,
                              "--threads", "1", "--set", "mapping.depth_scale=4"});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, HasSubstr("scale      metric")) << ran.out;
  const json run = json::parse(read(folder_ / "run/run.json"));
  EXPECT_EQ(run["world"]["frame"], "enu");
  EXPECT_EQ(run["world"]["segments"][0]["scale"], "metric");
  EXPECT_GT(run["world"]["segments"][0]["inliers"], 10);
  const json& o = run["world"]["origin"];
  const LocalFrame frame({o["latitude_deg"], o["longitude_deg"], o["altitude_m"]});

  // No alignment: the trajectory is where the flight was.
  const auto trajectory = read_trajectory(path("run/trajectory.txt"));
  ASSERT_TRUE(trajectory);
  const Trajectory truth = flight().truth();
  double squares = 0;
  for (const StampedPose& p : *trajectory) {
    const auto i = static_cast<std::size_t>(std::llround(1e-9 * double(p.time_ns) * 20));
    ASSERT_LT(i, truth.size());
    const Pose& T = truth[i].T_world_camera;
    squares += (p.T_world_camera.translation() - frame.to_enu(town().to_ecef(T.translation())))
                   .squaredNorm();
    EXPECT_LT(so3_log(p.T_world_camera.rotation().conjugate() * T.rotation()).norm(), 0.05);
  }
  const double rmse_m = std::sqrt(squares / static_cast<double>(trajectory->size()));
  std::cout << ran.out << "  ATE without alignment " << rmse_m << " m\n";
  EXPECT_LT(rmse_m, 0.2);
  EXPECT_NEAR(run["errors"]["trajectory"]["alignment_scale"].get<double>(), 1, 0.01);

  const std::string mesh = read(folder_ / "run/mesh.glb");
  EXPECT_THAT(mesh.substr(0, 4000), HasSubstr("\"rotation\":[-0.707")) << "z up is turned to y up";
}

TEST_F(PositionsTest, ScaleIsArbitraryWithout) {
  const Ran ran = corvid_run(
      {"replay", kFlight, "--out", path("run"), "--positions", "none", "--no-mapping", "--json"});
  ASSERT_EQ(ran.code, 0) << ran.err;
  EXPECT_THAT(ran.out, HasSubstr("\"scale\":\"arbitrary\""));
  EXPECT_EQ(ran.out.find("metric"), std::string::npos);
  const json run = json::parse(read(folder_ / "run/run.json"));
  EXPECT_EQ(run["world"]["frame"], "map");
  EXPECT_EQ(run["world"]["segments"][0]["scale"], "arbitrary");
}

TEST_F(PositionsTest, WrongFilesAndWrongClocksAreNamed) {
  const std::string header = "time_s,latitude_deg,longitude_deg,altitude_m\n";
  const std::string csv = write("bad.csv", header + "1,2,3,4\n2,2,3\n");
  const Ran bad = corvid_run({"replay", kFlight, "--out", path("run"), "--positions", csv});
  EXPECT_EQ(bad.code, 4);
  EXPECT_THAT(bad.err, HasSubstr("bad.csv:3"));
  EXPECT_EQ(corvid_run({"replay", kFlight, "--out", path("run"), "--positions", "/nowhere"}).code,
            3);
  const std::string other = write("other.csv", header + "1e6,47,8,4\n1000001,47,8,4\n");
  const Ran clock =
      corvid_run({"replay", kFlight, "--out", path("run"), "--positions", other, "--no-mapping"});
  EXPECT_EQ(clock.code, 0) << clock.err;
  EXPECT_THAT(clock.out, HasSubstr("None of the 2 positions belongs to a keyframe"));
}

}  // namespace
}  // namespace corvid
