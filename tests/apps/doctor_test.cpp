#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "apps/opencl_trouble.h"
#include "kernels/device.h"
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
    EXPECT_FALSE(entry.path().filename().string().starts_with("probe-")) << "the probe is left";
  }
}

// PoCL reads these once per process: this test needs a process of its own.
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

TEST_F(DoctorTest, ProcessorsAreMissedOnlyByPocl) {
  const std::filesystem::path absent = folder_ / "absent", vendors = folder_ / "vendors";
  std::filesystem::create_directories(vendors);
  const std::string gpu = write("vendors/gpu.icd", "libgpu.so\n");
  EXPECT_FALSE(missing_processors(absent, vendors)) << "no PoCL that would end the process";
  EXPECT_FALSE(missing_processors(absent, absent));
  const std::string pocl = write("vendors/cpu.icd", "libpocl.so.2\n");
  EXPECT_FALSE(missing_processors(folder_, vendors));
  EXPECT_FALSE(missing_processors(absent, gpu));
  for (const std::filesystem::path& named : {vendors, std::filesystem::path(pocl)}) {
    const auto missing = missing_processors(absent, named);
    ASSERT_TRUE(missing) << named;
    EXPECT_NE(missing->what.find("/sys"), std::string::npos);
    EXPECT_NE(missing->remedy.find("mount"), std::string::npos);
  }
}

// A process in which OpenCL was not yet loaded: it finds no device without the cache.
TEST_F(DoctorTest, OthersExplainTheSameTroubles) {
  if (access("/etc/OpenCL/vendors/pocl.icd", R_OK) != 0) GTEST_SKIP() << "PoCL is not installed";
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  const std::string file = write("a_file", "x");
  EXPECT_EXIT(
      {
        setenv("XDG_CACHE_HOME", file.c_str(), 1);
        setenv("OCL_ICD_VENDORS", "/etc/OpenCL/vendors/pocl.icd", 1);
        const Ran ran = corvid_run({"bench", "ncc", "--device", "cpu"});
        fputs(ran.err.c_str(), stderr);
        std::exit(ran.code);
      },
      ::testing::ExitedWithCode(5), "needs a cache that can be written.*export XDG_CACHE_HOME");
}

TEST_F(DoctorTest, ADeviceThatIsNotThereIsNotExplainedByTheCache) {
  const auto devices = list_devices();
  if (!devices) GTEST_SKIP() << "no OpenCL device";
  const char* before = std::getenv("XDG_CACHE_HOME");
  const std::string kept = before != nullptr ? before : "";
  setenv("XDG_CACHE_HOME", write("a_file", "x").c_str(), 1);
  const Ran ran = corvid_run({"bench", "ncc", "--device", "99"});
  before != nullptr ? setenv("XDG_CACHE_HOME", kept.c_str(), 1) : unsetenv("XDG_CACHE_HOME");
  EXPECT_EQ(ran.code, 5);
  EXPECT_NE(ran.err.find("no such OpenCL device"), std::string::npos) << ran.err;
  EXPECT_NE(ran.err.find("devices are 0: "), std::string::npos) << ran.err;
  EXPECT_EQ(ran.err.find("cache"), std::string::npos) << ran.err;
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
