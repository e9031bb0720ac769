#include "kernels/tuning.h"

#include <gmock/gmock.h>
#include <spdlog/sinks/ostream_sink.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <sstream>
#include <stdexcept>
#include <thread>
#include <vector>

#include "core/log.h"
#include "kernels/device.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Optional;

std::string read(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}
void write(const fs::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

DeviceInfo some_device() {
  DeviceInfo info;
  info.name = "Some processor";
  info.platform = "Some platform";
  info.version = "OpenCL 1.2, driver 3.1";
  info.compute_units = 4;
  return info;
}

class TuningTest : public ::testing::Test {
 protected:
  void SetUp() override {
    unsetenv("CORVID_TUNING");
    std::string name = (fs::temp_directory_path() / "corvid_tuning_XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override {
    unsetenv("CORVID_TUNING");
    fs::remove_all(folder_);
  }

  [[nodiscard]] Tuning open(const DeviceInfo& device = some_device()) {
    return Tuning(device, folder_ / "tuning", [this] { return now_ns_; });
  }
  // Takes the times given, one after the other, and then the last again and again.
  Tuning::Candidate costs(const std::string& name, std::vector<double> ms) {
    return {name, [this, name, ms, i = std::size_t{0}]() mutable {
              runs_ += name;
              now_ns_ += static_cast<std::int64_t>(ms[std::min(i++, ms.size() - 1)] * 1e6);
            }};
  }
  static Tuning::Candidate faulty(const std::string& name, int good_runs = 0) {
    return {name, [good_runs]() mutable {
              if (good_runs-- <= 0) throw DeviceFault("a launch", -5);
            }};
  }

  fs::path folder_;
  std::int64_t now_ns_ = 1'000'000;
  std::string runs_;  // names of the candidates that ran
};

TEST_F(TuningTest, WhatIsKeptIsFoundAgain) {
  {
    Tuning tuning = open();
    EXPECT_EQ(tuning.choice("a", "source 1"), std::nullopt);
    EXPECT_FALSE(fs::exists(tuning.file()));
    tuning.keep("a", "source 1", "left", {{"left", 1.5}, {"right", 2}});
    tuning.keep("b \"quoted\"\n", "source 1", "right", {});
    EXPECT_THAT(tuning.choice("a", "source 1"), Optional(std::string("left")));
  }
  Tuning again = open();
  EXPECT_THAT(again.choice("a", "source 1"), Optional(std::string("left")));
  EXPECT_THAT(again.choice("b \"quoted\"\n", "source 1"), Optional(std::string("right")));
  EXPECT_EQ(again.choice("c", "source 1"), std::nullopt);
  EXPECT_EQ(again.choice("a", "source 2"), std::nullopt);  // measured with other sources
  again.keep("a", "source 2", "right", {});
  EXPECT_THAT(open().choice("a", "source 2"), Optional(std::string("right")));
  EXPECT_THAT(open().choice("b \"quoted\"\n", "source 1"), Optional(std::string("right")));
  // Nothing but the file is left in the folder.
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_ / "tuning"), {}), 1);
}

TEST_F(TuningTest, TheFastestIsChosenOnce) {
  // Warm-ups do not count, nor does a single slow or fast run.
  std::vector<Tuning::Candidate> candidates{costs("a", {1, 3}), costs("b", {90, 2, 60, 2}),
                                            costs("c", {1, 4, 0.1, 4})};
  EXPECT_EQ(open().choose("job", "s", candidates), "b");
  // All were warmed up and then took turns.
  EXPECT_EQ(runs_, "abcabcabcabcabcabcabcabc");
  runs_.clear();
  EXPECT_EQ(open().choose("job", "s", candidates), "b");
  EXPECT_EQ(runs_, "");
  // What was measured stands in the file.
  EXPECT_THAT(read(open().file()), HasSubstr("\"b\": 2.0"));
  // A kept choice that is no candidate any more is measured anew.
  candidates.erase(candidates.begin() + 1);
  EXPECT_EQ(open().choose("job", "s", candidates), "a");
  EXPECT_NE(runs_, "");
  runs_.clear();
  EXPECT_EQ(open().choose("job", "other sources", candidates), "a");
  EXPECT_NE(runs_, "");
}

TEST_F(TuningTest, AmongEqualsTheFirstIsChosen) {
  const std::vector<Tuning::Candidate> candidates{costs("a", {2}), costs("b", {2})};
  EXPECT_EQ(open().choose("job", "s", candidates), "a");
}

TEST_F(TuningTest, MeasuringEndsWhenItTakesTooLong) {
  const std::vector<Tuning::Candidate> candidates{costs("a", {400}), costs("b", {300})};
  EXPECT_EQ(open().choose("job", "s", candidates), "b");
  EXPECT_EQ(runs_, "abab");  // warm-ups, which do not count, and one turn
}

TEST_F(TuningTest, CandidatesThatTheDeviceRefusesAreLeftOut) {
  const std::vector<Tuning::Candidate> one{faulty("x"), costs("a", {3}), faulty("y", 2),
                                           costs("b", {2})};
  EXPECT_EQ(open().choose("job", "s", one), "b");
  const std::vector<Tuning::Candidate> alone{faulty("x"), costs("a", {3}), faulty("y")};
  EXPECT_EQ(open().choose("other", "s", alone), "a");
  EXPECT_THAT(open().choice("other", "s"), Optional(std::string("a")));
  const std::vector<Tuning::Candidate> none{faulty("x"), faulty("y")};
  EXPECT_EQ(open().choose("third", "s", none), "x");
  EXPECT_EQ(open().choice("third", "s"), std::nullopt);
  // Only the device's faults: a bug comes out.
  const std::vector<Tuning::Candidate> bug{{"x", [] { throw std::logic_error("bug"); }}};
  Tuning tuning = open();
  EXPECT_THROW((void)tuning.choose("fourth", "s", bug), std::logic_error);
  EXPECT_EQ(tuning.choose("fourth", "s", alone), "a");  // and no lock stays behind
}

TEST_F(TuningTest, DamagedFilesAreIgnoredAndWrittenAgain) {
  Tuning first = open();
  first.keep("job", "s", "b", {{"a", 2.0}, {"b", 1.0}});
  const std::string good = read(first.file());
  std::vector<std::string> damaged{
      "",           "{}", "null", "[1, 2]", std::string(5000, '['), good.substr(0, good.size() / 2),
      "\xff\xfe\0x"};
  const auto replaced = [&](const std::string& what, const std::string& by) {
    std::string text = good;
    const std::size_t at = text.find(what);
    if (at == std::string::npos) throw std::runtime_error(what);
    return text.replace(at, what.size(), by);
  };
  damaged.push_back(replaced("corvid tuning 1", "corvid tuning 0"));
  damaged.push_back(replaced("\"b\",", "17,"));
  damaged.push_back(replaced("\"choices\"", "\"choice\""));
  damaged.push_back(replaced("1.0", "\"fast\""));
  for (const std::string& text : damaged) {
    ASSERT_NE(text, good);
    write(first.file(), text);
    Tuning tuning = open();
    EXPECT_EQ(tuning.choice("job", "s"), std::nullopt) << text;
    tuning.keep("job", "s", "b", {{"a", 2.0}, {"b", 1.0}});
    EXPECT_EQ(read(first.file()), good) << text;
  }
}

TEST_F(TuningTest, FilesOfAnotherStateOfTheDeviceAreIgnored) {
  open().keep("job", "s", "b", {});
  std::vector<DeviceInfo> others(4, some_device());
  others[0].version = "OpenCL 1.2, driver 4.0";
  others[1].compute_units = 8;
  others[2].platform = "Other platform";
  others[3].name = "Other processor";
  for (const DeviceInfo& other : others) {
    EXPECT_EQ(open(other).choice("job", "s"), std::nullopt);
    open(other).keep("job", "s", "a", {});
    EXPECT_THAT(open(other).choice("job", "s"), Optional(std::string("a")));
  }
  // Another device has another file; another driver's file replaced this one's.
  EXPECT_NE(open(others[2]).file(), open().file());
  EXPECT_NE(open(others[3]).file(), open().file());
  EXPECT_EQ(open().choice("job", "s"), std::nullopt);
  // A foreign file under this device's name is not believed.
  fs::copy_file(open(others[3]).file(), open().file(), fs::copy_options::overwrite_existing);
  EXPECT_EQ(open().choice("job", "s"), std::nullopt);
}

TEST_F(TuningTest, AFolderThatCannotBeWrittenDoesNoHarmAndIsLoggedOnce) {
  write(folder_ / "tuning", "a file where the folder should be");
  std::ostringstream lines;
  const auto sink = std::make_shared<spdlog::sinks::ostream_sink_mt>(lines);
  log().sinks().push_back(sink);
  Tuning tuning = open();
  const std::vector<Tuning::Candidate> candidates{costs("a", {3}), costs("b", {2})};
  EXPECT_EQ(tuning.choose("one", "s", candidates), "b");
  EXPECT_EQ(tuning.choose("two", "s", candidates), "b");
  runs_.clear();
  EXPECT_EQ(tuning.choose("one", "s", candidates), "b");
  EXPECT_EQ(runs_, "");
  std::erase(log().sinks(), sink);
  const std::string text = lines.str();
  const std::size_t line = text.find("cannot be kept");
  ASSERT_NE(line, std::string::npos);
  EXPECT_EQ(text.find("cannot be kept", line + 1), std::string::npos);
  EXPECT_TRUE(fs::is_regular_file(folder_ / "tuning"));
  // Without any folder, too.
  Tuning nowhere(some_device(), {}, [this] { return now_ns_; });
  EXPECT_EQ(nowhere.choose("one", "s", candidates), "b");
  EXPECT_THAT(nowhere.choice("one", "s"), Optional(std::string("b")));
}

TEST_F(TuningTest, OffTakesTheFirstAndTouchesNothing) {
  open().keep("job", "s", "b", {});
  const std::string before = read(open().file());
  setenv("CORVID_TUNING", "off", 1);
  Tuning tuning = open();
  EXPECT_FALSE(tuning.enabled());
  const std::vector<Tuning::Candidate> candidates{costs("a", {3}), costs("b", {2})};
  EXPECT_EQ(tuning.choose("job", "s", candidates), "a");
  EXPECT_EQ(runs_, "");
  EXPECT_EQ(tuning.choice("job", "s"), std::nullopt);
  tuning.keep("job", "s", "a", {});
  EXPECT_TRUE(tuning.file().empty());
  unsetenv("CORVID_TUNING");
  EXPECT_EQ(read(open().file()), before);
}

TEST_F(TuningTest, SeveralWritersLoseNothingOfEachOther) {
  Tuning one = open(), two = open();
  EXPECT_EQ(one.choice("a", "s"), std::nullopt);
  EXPECT_EQ(two.choice("a", "s"), std::nullopt);
  one.keep("a", "s", "x", {});
  two.keep("b", "s", "y", {});
  EXPECT_THAT(open().choice("a", "s"), Optional(std::string("x")));
  EXPECT_THAT(open().choice("b", "s"), Optional(std::string("y")));
  // Many threads, one object: each job is measured once.
  Tuning shared = open();
  std::mutex mutex;
  int measured = 0;
  {
    std::vector<std::jthread> threads;
    for (int t = 0; t < 8; ++t)
      threads.emplace_back([&, t] {
        const std::vector<Tuning::Candidate> candidates{{"x",
                                                         [&] {
                                                           const std::lock_guard lock(mutex);
                                                           ++measured;
                                                         }},
                                                        {"y", [] {}}};
        (void)shared.choose("shared", "s", candidates);
        shared.keep("own " + std::to_string(t), "s", "x", {});
      });
  }
  EXPECT_EQ(measured, 8);  // a warm-up and seven turns
  for (int t = 0; t < 8; ++t)
    EXPECT_TRUE(open().choice("own " + std::to_string(t), "s").has_value());
}

}  // namespace
}  // namespace corvid
