#pragma once

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <cstdio>
#include <string>
#include <utility>

#include "vm/guest.h"

namespace corvid::vm {

/// The program uvc_camera (uvc_camera/uvc_camera.cpp): a USB camera that is plugged in as long as
/// this object lives. Two at once take two ports.
class EmulatedCamera {
 public:
  explicit EmulatedCamera(int port = 0) {
    const std::vector<std::string> before = nodes();
    std::array<int, 2> commands{}, answers{};
    if (::pipe2(commands.data(), O_CLOEXEC) != 0 || ::pipe2(answers.data(), O_CLOEXEC) != 0) return;
    const std::string port_text = std::to_string(port);
    child_ = ::fork();
    if (child_ == 0) {
      ::dup2(commands[0], STDIN_FILENO);
      ::dup2(answers[1], STDOUT_FILENO);
      ::execl(CORVID_UVC_CAMERA, CORVID_UVC_CAMERA, port_text.c_str(), nullptr);
      ::_exit(127);
    }
    ::close(commands[0]);
    ::close(answers[1]);
    commands_ = commands[1];
    answers_ = ::fdopen(answers[0], "r");
    // The new node: the kernel gives out the lowest number that is free.
    EXPECT_TRUE(eventually([&] {
      for (const std::string& node : nodes()) {
        if (std::find(before.begin(), before.end(), node) == before.end()) node_ = node;
      }
      return !node_.empty();
    })) << "the emulated camera has no video node";
  }
  EmulatedCamera(const EmulatedCamera&) = delete;
  EmulatedCamera& operator=(const EmulatedCamera&) = delete;
  ~EmulatedCamera() { unplug(); }

  /// "/dev/video0".
  [[nodiscard]] const std::string& node() const { return node_; }

  /// Sends a command; returns the number of the next picture.
  std::uint32_t command(const std::string& text) {
    const std::string line = text + "\n";
    char answer[32] = "";
    if (::write(commands_, line.data(), line.size()) < 0 ||
        std::fgets(answer, sizeof answer, answers_) == nullptr) {
      ADD_FAILURE() << "the emulated camera does not answer";
    }
    return static_cast<std::uint32_t>(std::strtoul(answer, nullptr, 10));
  }

  /// Pulls the plug, and waits until the node is gone from the list of devices.
  void unplug() {
    if (child_ <= 0) return;
    ::close(commands_);
    std::fclose(answers_);
    ::waitpid(std::exchange(child_, 0), nullptr, 0);
    const std::string entry = "/sys/class/video4linux/" + node_.substr(node_.rfind('/') + 1);
    EXPECT_TRUE(eventually([&] { return !std::filesystem::exists(entry); }));
  }

 private:
  static std::vector<std::string> nodes() { return video_nodes("Test UVC Camera"); }

  pid_t child_ = 0;
  int commands_ = -1;
  std::FILE* answers_ = nullptr;
  std::string node_;
};

}  // namespace corvid::vm
