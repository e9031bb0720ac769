#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "kernels/vendor_files.h"
#include "program_fixture.h"

namespace corvid {
namespace {

using nlohmann::json;

using DoctorTest = ProgramTest;

json finding(const json& report, const std::string& topic) {
  for (const json& f : report["findings"]) {
    if (f["topic"] == topic) return f;
  }
  return {};
}

TEST_F(DoctorTest, ReportsEveryTopicAndItsVerdictDecidesTheCode) {
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
  std::error_code none;
  for (const auto& entry : std::filesystem::directory_iterator(cache_folder(), none)) {
    EXPECT_FALSE(entry.path().filename().string().starts_with("doctor-")) << "the probe is left";
  }
}

// PoCL reads these once per process: each of the next two needs a process of its own.
TEST_F(DoctorTest, ACacheThatCannotBeWrittenIsNamedWithItsRemedy) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  const std::string file = write("a_file", "x");
  EXPECT_EXIT(
      {
        setenv("XDG_CACHE_HOME", file.c_str(), 1);
        const Ran ran = corvid_run({"doctor", "--json"});
        const json cache = finding(json::parse(ran.out), "cache");
        fputs((cache["verdict"].get<std::string>() + cache["remedy"].get<std::string>()).c_str(),
              stderr);
        std::exit(0);
      },
      ::testing::ExitedWithCode(0), "warningexport XDG_CACHE_HOME");
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
