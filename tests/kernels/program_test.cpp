#include "kernels/program.h"

#include <gmock/gmock.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <optional>

#include "kernels/corners.h"
#include "kernels/test_device.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

std::string read(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}
void write(const fs::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

// A folder of its own for the program cache; what the driver caches was settled when it was loaded.
class ProgramCache : public ::testing::Test {
 protected:
  void SetUp() override {
    (void)test_device();
    std::string name = (fs::temp_directory_path() / "corvid_programs_XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
    if (const char* old = std::getenv("XDG_CACHE_HOME")) old_ = old;
    setenv("XDG_CACHE_HOME", name.c_str(), 1);
  }
  void TearDown() override {
    if (old_)
      setenv("XDG_CACHE_HOME", old_->c_str(), 1);
    else
      unsetenv("XDG_CACHE_HOME");
    unsetenv("CORVID_KERNEL_DIR");
    fs::permissions(folder_, fs::perms::owner_all);
    fs::remove_all(folder_);
  }

  // With a new device, since each device remembers its programs.
  static std::shared_ptr<Device> fresh_device() {
    return *Device::open(std::to_string(test_device()->info().index));
  }
  // Builds the kernels of corners and sees that they work.
  static void build_and_use() {
    const auto device = fresh_device();
    auto detector = CornerDetector::create(device);
    ASSERT_TRUE(detector) << detector.error().to_string();
    EXPECT_TRUE(detector->detect(upload(*device, GreyImage(40, 40, 9)), {}).empty());
  }
  [[nodiscard]] std::vector<fs::path> files() const {
    std::vector<fs::path> found;
    const fs::path programs = folder_ / "corvid" / "programs";
    if (fs::exists(programs))
      for (const auto& entry : fs::directory_iterator(programs)) found.push_back(entry.path());
    return found;
  }

  fs::path folder_;
  std::optional<std::string> old_;
};

TEST_F(ProgramCache, IsFilledOnceAndThenRead) {
  build_and_use();
  const auto first = files();
  ASSERT_EQ(first.size(), 1U);
  EXPECT_THAT(first[0].filename().string(), HasSubstr("corners-"));
  const std::string content = read(first[0]);
  const auto written = fs::last_write_time(first[0]);
  // A program that is found there is taken: other options would make another file.
  build_and_use();
  EXPECT_EQ(files(), first);
  EXPECT_EQ(fs::last_write_time(first[0]), written);
  EXPECT_EQ(read(first[0]), content);
  ASSERT_TRUE(build_program(*fresh_device(), "corners", "-DLANES=1 -DOTHER=1"));
  EXPECT_EQ(files().size(), 2U);
}

TEST_F(ProgramCache, DamagedFilesAreIgnoredAndWrittenAgain) {
  build_and_use();
  ASSERT_EQ(files().size(), 1U);
  const fs::path path = files()[0];
  const std::string good = read(path);
  std::map<std::string, std::string> damaged;
  damaged["empty"] = "";
  damaged["short"] = good.substr(0, good.size() / 2);
  damaged["header only"] = good.substr(0, 30);
  damaged["longer"] = good + "x";
  damaged["nothing alike"] = std::string(5000, '\n');
  damaged["flipped bit"] = good;
  damaged["flipped bit"][good.size() - 100] ^= 1;
  damaged["other device"] = good;
  damaged["other device"].replace(good.find(test_device()->info().name), 4, "abcd");
  for (const auto& [kind, text] : damaged) {
    ASSERT_NE(text, good);
    write(path, text);
    build_and_use();
    EXPECT_EQ(files().size(), 1U) << kind;
    EXPECT_NE(read(path), text) << kind;
    EXPECT_EQ(read(path).substr(0, 100), good.substr(0, 100)) << kind;
  }
}

TEST_F(ProgramCache, ABinaryThatTheDriverRefusesIsBuiltAnew) {
  build_and_use();
  const fs::path path = files()[0];
  const std::string good = read(path);
  // A file with a right header around bytes that are no program: FNV-1a as in the cache.
  const std::string binary = "this is no program";
  std::uint64_t hash = 14695981039346656037ULL;
  for (const char c : binary) hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211ULL;
  char size_line[64];
  std::snprintf(size_line, sizeof size_line, "%zu %016llx\n", binary.size(),
                static_cast<unsigned long long>(hash));
  const std::size_t key_end = good.find('\n', good.find('\n') + 1);
  write(path, good.substr(0, key_end + 1) + size_line + binary);
  build_and_use();
  EXPECT_THAT(read(path), testing::Not(HasSubstr(binary)));
}

TEST_F(ProgramCache, AFolderThatCannotBeWrittenDoesNoHarm) {
  write(folder_ / "corvid", "a file where the folder should be");
  build_and_use();
  EXPECT_TRUE(fs::is_regular_file(folder_ / "corvid"));
}

TEST_F(ProgramCache, SourcesCanComeFromAFolder) {
  const fs::path sources = folder_ / "sources";
  fs::create_directories(sources);
  setenv("CORVID_KERNEL_DIR", sources.c_str(), 1);
  const auto device = fresh_device();
  auto missing = build_program(*device, "pyramid");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::not_found);
  EXPECT_THAT(missing.error().where, HasSubstr("pyramid.cl"));
  write(sources / "pyramid.cl", "__kernel void one(__global int* p) { p[0] = 1; }");
  auto program = build_program(*device, "pyramid");
  ASSERT_TRUE(program) << program.error().to_string();
  EXPECT_NO_THROW(cl::Kernel(*program, "one"));
  // The same device sees a change at once.
  write(sources / "pyramid.cl", "__kernel void two(__global int* p) { p[0] = 2; }");
  program = build_program(*device, "pyramid");
  ASSERT_TRUE(program) << program.error().to_string();
  EXPECT_NO_THROW(cl::Kernel(*program, "two"));
}

TEST_F(ProgramCache, ErrorsShowTheBuildLog) {
  const fs::path sources = folder_ / "sources";
  fs::create_directories(sources);
  setenv("CORVID_KERNEL_DIR", sources.c_str(), 1);
  write(sources / "pyramid.cl", "__kernel void halve() { undeclared_name = 1; }");
  const auto program = PyramidBuilder::create(fresh_device());
  ASSERT_FALSE(program);
  EXPECT_EQ(program.error().code, ErrorCode::device);
  EXPECT_THAT(program.error().what, HasSubstr("undeclared_name"));
  EXPECT_THAT(program.error().where, HasSubstr("pyramid.cl"));
}

TEST(Program, UnknownNamesAreNotFound) {
  const auto program = build_program(*test_device(), "no_such_kernel");
  ASSERT_FALSE(program);
  EXPECT_EQ(program.error().code, ErrorCode::not_found);
}

TEST(Program, EmbeddedSourcesAreTheFiles) {
  std::size_t count = 0;
  for (const auto& entry : fs::directory_iterator(fs::path(CORVID_SOURCE_DIR) / "kernels"))
    if (entry.path().extension() == ".cl") ++count;
  EXPECT_EQ(embedded_kernels().size(), count);
  for (const EmbeddedKernel& kernel : embedded_kernels()) {
    const fs::path path =
        fs::path(CORVID_SOURCE_DIR) / "kernels" / (std::string(kernel.name) + ".cl");
    EXPECT_TRUE(read(path) == kernel.source) << kernel.name;  // not 20 kB of message
    EXPECT_EQ(kernel.sha256.size(), 64U) << kernel.name;
  }
}

// Every .cl file is OpenCL C 1.2 for a compiler that knows no device of ours.
TEST(Program, KernelsCompileWithoutADevice) {
  if (std::system("clang --version > /dev/null 2>&1") != 0)
    GTEST_SKIP() << "clang is not installed (apt install clang)";
  const std::string common = " -include ncc_common.cl",
                    templates = common + " -include ncc_templates.cl",
                    size = "-DTW=3 -DTH=5 -DWEIGHTS_X=0.1f -DWEIGHTS_Y=0.1f ",
                    uniform = size +
                              "-DUNIFORM -DINTEGER -DLANES=16 -DROWS=4 -DPIECE_W=704 "
                              "-DPIECE_H=32",
                    weighted = size + "-DLANES=8 -DROWS=4 -DPIECE_W=704 -DPIECE_H=32",
                    floats = size + "-DFLOAT_IMAGE -DLANES=4 -DROWS=4 -DPIECE_W=704 -DPIECE_H=32",
                    group = size + "-DLANES=4 -DROWS=8 -DPIECE_W=30 -DPIECE_H=30";
  // Families that want build options or the files that stand before them; each line is tried.
  const std::map<std::string, std::vector<std::string>> options = {
      {"ncc_common", {uniform, weighted, floats}},
      {"ncc_templates", {uniform + common, weighted + common, floats + common}},
      {"ncc_score", {uniform + templates, weighted + templates, floats + templates}},
      {"ncc_group",
       {group + templates, group + " -DUNIFORM" + templates, group + " -DFLOAT_IMAGE" + templates}},
      {"ncc_peaks", {uniform + templates, weighted + templates, floats + templates}},
      {"depth",
       {"-DVEC=16 -DRADIUS=1 -DWEIGHTS=0.25f,0.5f,0.25f -DMIN_SCORE=0.6f -DMIN_VIEWS=2 "
        "-DMIN_VARIANCE=1.0f -DPAD=16",
        "-DVEC=1 -DRADIUS=1 -DWEIGHTS=0.25f,0.5f,0.25f -DMIN_SCORE=0.6f -DMIN_VIEWS=2 "
        "-DMIN_VARIANCE=1.0f -DPAD=16"}},
      {"pyramid", {"", "-DFLOAT_IMAGE"}},
      {"corners", {"-DLANES=1", "-DLANES=16"}},
      {"warp", {"-DLANES=1", "-DLANES=16", "-DLANES=1 -DFLOAT_IMAGE", "-DLANES=16 -DFLOAT_IMAGE"}},
      {"filter",
       {"-DLANES=1 -DTILE=128 -DMEMBERS=128", "-DLANES=16 -DTILE=1024 -DMEMBERS=1",
        "-DLANES=1 -DTILE=128 -DMEMBERS=128 -DFLOAT_IMAGE",
        "-DLANES=16 -DTILE=1024 -DMEMBERS=1 -DFLOAT_IMAGE"}},
  };
  for (const EmbeddedKernel& kernel : embedded_kernels()) {
    const auto found = options.find(std::string(kernel.name));
    const std::vector<std::string> plain{""};
    for (const std::string& option : found == options.end() ? plain : found->second) {
      const std::string command =
          "clang -x cl -cl-std=CL1.2 -Xclang -finclude-default-header -fsyntax-only -Wall "
          "-Werror " +
          option + " -I '" + CORVID_SOURCE_DIR + "/kernels' '" + CORVID_SOURCE_DIR + "/kernels/" +
          std::string(kernel.name) + ".cl'";
      EXPECT_EQ(std::system(command.c_str()), 0) << command;
    }
  }
}

}  // namespace
}  // namespace corvid
