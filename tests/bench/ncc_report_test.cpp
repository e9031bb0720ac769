#include "bench/ncc_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "bench/bench_image.h"

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::Not;

// 1e6 coefficients of 11x11 in 2 ms: 0.5e9 per second, 121 GFLOP/s.
NccReport one_dense_row() {
  NccReport report;
  report.peak_gflops = 242;
  report.peak_measurements = 1;
  report.machine.processor = "a processor";
  NccRow row;
  row.name = "11x11 in 1010x1010";
  row.template_width_px = row.template_height_px = 11;
  row.image_width_px = row.image_height_px = 1010;
  row.coefficients = 1e6;
  row.corvid = {2, 1.5, 4};
  row.opencv = Timing{30, 20, 31};
  row.largest_difference = 1e-4;
  report.rows.push_back(row);
  return report;
}

TEST(NccReport, RatesFollowFromTheMedian) {
  const json row = json::parse(json_rows(one_dense_row())).at(0);
  EXPECT_EQ(row["table"], "dense");
  EXPECT_EQ(row["template_px"], 11);
  EXPECT_EQ(row["image_px"], 1010);
  EXPECT_EQ(row["corvid_ms"], 2);
  EXPECT_EQ(row["opencv_ms"], 30);
  EXPECT_EQ(row["corvid_cpu_ms"], 4);
  EXPECT_EQ(row["opencv_cpu_ms"], 31);
  EXPECT_DOUBLE_EQ(row["ratio"], 15);
  EXPECT_DOUBLE_EQ(row["gcoefficients_per_s"], 0.5);
  EXPECT_DOUBLE_EQ(row["gflops"], 121);
  EXPECT_DOUBLE_EQ(row["share_of_peak"], 0.5);
}

TEST(NccReport, WhatIsNotThereIsNull) {
  NccReport report = one_dense_row();
  report.peak_gflops = 0;
  report.rows[0].opencv.reset();
  NccRow corners;
  corners.table = NccTable::features;
  corners.name = "corners";
  corners.image_width_px = 752;
  corners.image_height_px = 480;
  corners.corvid = {4, 3, 4};
  report.rows.push_back(corners);
  const json rows = json::parse(json_rows(report));
  for (const char* key : {"opencv_ms", "ratio", "share_of_peak", "upload_ms"}) {
    EXPECT_TRUE(rows[0].at(key).is_null()) << key;
  }
  for (const char* key : {"template_px", "gflops", "coefficients", "largest_difference"}) {
    EXPECT_TRUE(rows[1].at(key).is_null()) << key;
  }
  std::ostringstream text;
  print(report, text);
  EXPECT_THAT(text.str(), HasSubstr("corners"));
  EXPECT_THAT(text.str(), Not(HasSubstr("nan")));
}

TEST(NccReport, WithoutRowsItIsAnEmptyArrayAndSaysSo) {
  EXPECT_EQ(json::parse(json_rows({})), json::array());
  std::ostringstream text;
  print({}, text);
  EXPECT_THAT(text.str(), HasSubstr("Nothing was measured"));
}

TEST(NccReport, CoefficientsThatAreNotOpenCvsAreNamed) {
  NccReport report = one_dense_row();
  EXPECT_TRUE(disagreements(report).empty());
  for (const double wrong : {0.02, std::numeric_limits<double>::quiet_NaN()}) {
    report.rows[0].largest_difference = wrong;
    const auto found = disagreements(report);
    ASSERT_EQ(found.size(), 1U);
    EXPECT_THAT(found[0], HasSubstr("11x11 in 1010x1010"));
  }
}

TEST(BenchImage, IsTheSameEachTimeAndNowhereConstant) {
  const GreyImage image = bench_image(301, 207);
  EXPECT_EQ(image, bench_image(301, 207));
  for (int y = 1; y + 1 < image.height(); ++y) {
    for (int x = 1; x + 1 < image.width(); ++x) {
      bool constant = true;
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          constant = constant && image(x + dx, y + dy) == image(x, y);
        }
      }
      ASSERT_FALSE(constant) << x << " " << y;
    }
  }
}

}  // namespace
}  // namespace corvid
