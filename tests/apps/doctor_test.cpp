#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "program_fixture.h"

namespace corvid {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

using DoctorTest = ProgramTest;

json finding(const json& report, const std::string& topic) {
  for (const json& f : report["findings"]) {
    if (f["topic"] == topic) return f;
  }
  return {};
}

TEST_F(DoctorTest, ReportsEveryTopicAndItsVerdictDecidesTheCode) {
  setenv("XDG_CACHE_HOME", folder_.c_str(), 1);
  const Ran ran = corvid_run({"doctor", "--json"});
  const json report = json::parse(ran.out);
  for (const char* topic : {"opencl", "cache", "camera", "libcamera", "memory", "disk", "locale"}) {
    EXPECT_FALSE(finding(report, topic).is_null()) << topic;
  }
  const bool failure = std::any_of(report["findings"].begin(), report["findings"].end(),
                                   [](const json& f) { return f["verdict"] == "FAILURE"; });
  EXPECT_EQ(ran.code, failure ? 5 : 0);
  EXPECT_EQ(report["runs"], !failure);
  for (const json& f : report["findings"]) {
    EXPECT_EQ(f["verdict"] == "warning" || f["verdict"] == "FAILURE", f["remedy"] != "") << f;
  }
  EXPECT_EQ(finding(report, "cache")["verdict"], "ok");
  EXPECT_TRUE(std::filesystem::is_empty(folder_ / "corvid")) << "the probe is gone";
}

TEST_F(DoctorTest, ACacheThatCannotBeWrittenIsAWarningWithItsRemedy) {
  setenv("XDG_CACHE_HOME", write("a_file", "x").c_str(), 1);
  const Ran ran = corvid_run({"doctor", "--json"});
  const json cache = finding(json::parse(ran.out), "cache");
  EXPECT_EQ(cache["verdict"], "warning");
  EXPECT_THAT(cache["remedy"].get<std::string>(), HasSubstr("XDG_CACHE_HOME"));
}

TEST_F(DoctorTest, WithoutAnyDriverTheCodeIsFiveAndTheRemedyIsNamed) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");  // a process in which OpenCL was not yet loaded
  EXPECT_EXIT(
      {
        setenv("OCL_ICD_VENDORS", "/nonexistent", 1);
        const Ran ran = corvid_run({"doctor"});
        fputs(ran.out.c_str(), stderr);
        std::exit(ran.code);
      },
      ::testing::ExitedWithCode(5), "FAILURE +opencl[^\n]*\n +mend it: .*pocl-opencl-icd");
}

}  // namespace
}  // namespace corvid
