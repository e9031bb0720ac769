#include "bench/matching/matching_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <sstream>

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

MatchingReport one_row() {
  MatchingReport report;
  report.machine.processor = "a processor";
  report.runs = 1;
  MatchingRow row;
  row.set = "a_set";
  row.width_px = 640;
  row.height_px = 480;
  row.images = 3;
  row.sift = {{3, 1000, 0.2, 1.0, 400, 500},
              {2, 800, 0.1, 0.5, 410, 500},
              {1, 200, 0.3, 3.0, 380, 380},
              600,
              3,
              0.5,
              2.5,
              90};
  row.corvid = {{3, 2500, 0.1, 0.5, 100, 150},
                {2, 1900, 0.1, 0.5, 90, 110},
                {1, 600, 0.1, 0.5, 150, 150},
                1200,
                3,
                0.2,
                2.7,
                95};
  report.rows.push_back(row);
  return report;
}

TEST(MatchingReport, TheRowHasEveryNamedField) {
  const json row = json::parse(json_rows(one_row())).at(0);
  EXPECT_EQ(row["set"], "a_set");
  EXPECT_EQ(row["pairs"], 3);
  EXPECT_EQ(row["sift_matches"], 1000);
  EXPECT_EQ(row["corvid_matches"], 2500);
  EXPECT_EQ(row["sift_points"], 600);
  EXPECT_EQ(row["corvid_points"], 1200);
  EXPECT_EQ(row["sift_mse_px2"], 0.5);
  EXPECT_EQ(row["corvid_mse_px2"], 0.2);
  EXPECT_EQ(row["sift_truth_px"], 0.2);
  EXPECT_EQ(row["corvid_truth_px"], 0.1);
  EXPECT_EQ(row["sift_wrong_percent"], 1.0);
  EXPECT_EQ(row["corvid_wrong_percent"], 0.5);
  EXPECT_EQ(row["sift_ms"], 400);
  EXPECT_EQ(row["corvid_ms"], 100);
  EXPECT_DOUBLE_EQ(row["matches_ratio"], 2.5);
  EXPECT_DOUBLE_EQ(row["points_ratio"], 2);
  EXPECT_DOUBLE_EQ(row["mse_ratio"], 0.4);
  EXPECT_DOUBLE_EQ(row["time_ratio"], 4);
  ASSERT_EQ(row["gaps"].size(), 2U);
  EXPECT_EQ(row["gaps"][1]["gap"], 2);
  EXPECT_EQ(row["gaps"][1]["corvid_matches"], 600);
  std::ostringstream out;
  print(one_row(), out);
  EXPECT_THAT(out.str(), HasSubstr("a_set: 3 images of 640x480, 3 pairs"));
  EXPECT_THAT(out.str(), HasSubstr("2.50"));
}

TEST(MatchingReport, WhatIsNotThereIsNull) {
  MatchingReport report = one_row();
  report.rows[0].sift = {};
  report.rows[0].corvid.all.truth_px.reset();
  const json row = json::parse(json_rows(report)).at(0);
  for (const char* key : {"sift_mse_px2", "sift_truth_px", "corvid_truth_px", "sift_ms",
                          "matches_ratio", "points_ratio", "mse_ratio", "time_ratio"})
    EXPECT_TRUE(row.at(key).is_null()) << key;
  EXPECT_EQ(row["sift_matches"], 0);
  std::ostringstream out;
  print(report, out);
  EXPECT_THAT(out.str(), HasSubstr(" - "));
}

TEST(MatchingReport, WithoutRowsItIsAnEmptyArray) {
  EXPECT_TRUE(json::parse(json_rows({})).empty());
  std::ostringstream out;
  print(MatchingReport{}, out);
  EXPECT_THAT(out.str(), HasSubstr("Nothing was measured"));
}

}  // namespace
}  // namespace corvid
