#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "apps/program.h"

namespace corvid {

/// What one command did.
struct Ran {
  int code = -1;
  std::string out, err;
};

/// Runs `corvid ARGUMENTS...` in this process.
inline Ran corvid_run(const std::vector<std::string>& arguments, bool terminal = false) {
  std::vector<const char*> argv{"corvid"};
  for (const std::string& argument : arguments) argv.push_back(argument.c_str());
  std::ostringstream out, err;
  Ran ran;
  ran.code =
      run_program(static_cast<int>(argv.size()), argv.data(), Context{out, err, terminal, false});
  ran.out = out.str();
  ran.err = err.str();
  return ran;
}

/// Does something, once, when a line with `text` has gone through it.
class WatchingBuffer : public std::stringbuf {
 public:
  WatchingBuffer(std::string text, std::function<void()> action)
      : text_(std::move(text)), action_(std::move(action)) {}

 protected:
  int sync() override {
    if (action_ && str().find(text_) != std::string::npos) std::exchange(action_, nullptr)();
    return 0;
  }

 private:
  std::string text_;
  std::function<void()> action_;
};

/// Sends SIGINT to this process, `times` times, when a line with `text` has gone through it.
class SignallingBuffer : public WatchingBuffer {
 public:
  explicit SignallingBuffer(std::string text, int times = 1)
      : WatchingBuffer(std::move(text), [times] {
          for (int i = 0; i < times; ++i) std::raise(SIGINT);
        }) {}
};

/// A folder of its own for each test, removed at its end.
class ProgramTest : public ::testing::Test {
 protected:
  ProgramTest() {
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    folder_ = std::filesystem::path(::testing::TempDir()) /
              ("corvid_" + std::string(info->test_suite_name()) + "_" + info->name() + "_" +
               std::to_string(getpid()));
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~ProgramTest() override {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  [[nodiscard]] std::string path(const std::string& name) const {
    return (folder_ / name).string();
  }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name) << text;
    return path(name);
  }
  [[nodiscard]] static std::string read(const std::filesystem::path& file) {
    std::ifstream stream(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
  }

  std::filesystem::path folder_;
};

}  // namespace corvid
