#include "io/positions_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "io/source_test_files.h"

namespace corvid {
namespace {

using test::TempFolder;
using test::write_text;
using testing::HasSubstr;

Expected<PositionsFile> read(const std::string& text) {
  const TempFolder t;
  write_text(t / "p.csv", text);
  return read_positions(t / "p.csv");
}

TEST(PositionsFile, ReadsColumnsInAnyOrder) {
  const auto file = read(
      "\xEF\xBB\xBF# from a receiver\r\n"
      "satellites, longitude_deg,latitude_deg ,altitude_m,time_s,sigma_vertical_m,"
      "sigma_horizontal_m\r\n"
      "9,-98.09,30.17,317.3,1.000000001,0.5,0.2\r\n"
      "\r\n"
      "0,nan,NaN,nan,2,,\r\n"
      "9,-98.08,30.18,318,-3,0.5,0.2\r\n");
  ASSERT_TRUE(file) << file.error().to_string();
  ASSERT_EQ(file->fixes.size(), 2U);
  EXPECT_EQ(file->without_fix, 1);
  const PositionFix& fix = file->fixes[0];
  EXPECT_EQ(fix.time_ns, 1'000'000'001);
  EXPECT_EQ(fix.position.latitude_deg, 30.17);
  EXPECT_EQ(fix.position.longitude_deg, -98.09);
  EXPECT_EQ(fix.position.altitude_m, 317.3);
  EXPECT_NEAR(fix.covariance_m2(0, 0), 0.04, 1e-12);
  EXPECT_NEAR(fix.covariance_m2(2, 2), 0.25, 1e-12);
  EXPECT_EQ(file->fixes[1].time_ns, -3'000'000'000);
}

TEST(PositionsFile, OfFramesByName) {
  const auto file =
      read("name,latitude_deg,longitude_deg,altitude_m\n\"IMG 1.jpg\",30.17,-98.09,317.3\n");
  ASSERT_TRUE(file) << file.error().to_string();
  EXPECT_EQ(file->fixes[0].frame_name, "IMG 1.jpg");
  EXPECT_EQ(file->fixes[0].covariance_m2, PositionFix().covariance_m2);
}

TEST(PositionsFile, SaysWhatIsWrongAndWhere) {
  const std::string header = "time_ns,latitude_deg,longitude_deg,altitude_m\n";
  const auto error = [](const std::string& text) {
    const auto file = read(text);
    EXPECT_FALSE(file) << text;
    return file ? std::string() : file.error().to_string();
  };
  EXPECT_THAT(error(""), HasSubstr("says nothing"));
  EXPECT_THAT(error(header), HasSubstr("not one row"));
  EXPECT_THAT(error(header + "1,nan,nan,nan\n"), HasSubstr("not one row"));
  EXPECT_THAT(error("time_ns,lattitude_deg,longitude_deg,altitude_m\n1,2,3,4\n"),
              testing::AllOf(HasSubstr(":1"), HasSubstr("no column `latitude_deg`"),
                             HasSubstr("lattitude_deg")));
  EXPECT_THAT(error("latitude_deg,longitude_deg,altitude_m\n1,2,3\n"), HasSubstr("time_ns"));
  EXPECT_THAT(error("time_s," + header + "1,1,2,3,4\n"), HasSubstr("one of the columns"));
  EXPECT_THAT(error("altitude_m," + header + "1,1,2,3,4\n"), HasSubstr("two columns"));
  EXPECT_THAT(error(header + "1,2,3,4\n1,2,3\n"),
              testing::AllOf(HasSubstr(":3"), HasSubstr("3 columns, the header has 4")));
  EXPECT_THAT(error(header + "1.5,2,3,4\n"), HasSubstr("\"1.5\" is not a time in nanoseconds"));
  EXPECT_THAT(error(header + "1,2,x,4\n"), HasSubstr("longitude_deg: \"x\" is not a number"));
  EXPECT_THAT(error(header + "1,2,3,nan\n"), HasSubstr("altitude_m"));
  EXPECT_THAT(error(header + "1,91,3,4\n"), HasSubstr("latitude 91"));
  EXPECT_EQ(read_positions("/nowhere/p.csv").error().code, ErrorCode::not_found);
}

}  // namespace
}  // namespace corvid
