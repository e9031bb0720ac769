#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

/// Tests that run in the guest of tests/vm/boot.sh, and are skipped anywhere else.
namespace corvid::vm {

inline bool in_guest() { return std::getenv("CORVID_VM") != nullptr; }

/// Fixture of every test of vm_tests.
class GuestTest : public testing::Test {
 protected:
  void SetUp() override {
    if (!in_guest()) GTEST_SKIP() << "runs in the guest only: ctest -L vm";
  }
};

/// What a slow machine is given before a test is said to hang.
constexpr std::chrono::seconds kPatience{60};

/// Waits until `condition` holds; false if it did not within kPatience.
template <class Condition>
bool eventually(const Condition& condition) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return true;
}

inline std::string first_line(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  return line;
}

/// The nodes ("/dev/video0") of the cameras whose name contains `name`, in the order of their
/// numbers; of a camera with several nodes (UVC: pictures and metadata) the first.
inline std::vector<std::string> video_nodes(const std::string& name) {
  std::vector<std::pair<int, std::string>> found;
  std::error_code gone;  // devices come and go
  for (const auto& entry : std::filesystem::directory_iterator("/sys/class/video4linux", gone)) {
    const std::string node = entry.path().filename();
    if (!node.starts_with("video") || first_line(entry.path() / "index") != "0") continue;
    if (first_line(entry.path() / "name").find(name) == std::string::npos) continue;
    if (!std::filesystem::exists("/dev/" + node)) continue;
    found.emplace_back(std::atoi(node.c_str() + 5), "/dev/" + node);
  }
  std::sort(found.begin(), found.end());
  std::vector<std::string> nodes;
  for (auto& [number, node] : found) nodes.push_back(std::move(node));
  return nodes;
}

}  // namespace corvid::vm
