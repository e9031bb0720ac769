#pragma once

#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <optional>
#include <string>

/// Another program's access to a V4L2 node: inputs, and controls by name.
namespace corvid::vm {

class ControlPanel {
 public:
  explicit ControlPanel(const std::string& node)
      : fd_(::open(node.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC)) {}
  ControlPanel(const ControlPanel&) = delete;
  ControlPanel& operator=(const ControlPanel&) = delete;
  ~ControlPanel() { ::close(fd_); }

  [[nodiscard]] bool set_input(int input) const {
    return ::ioctl(fd_, VIDIOC_S_INPUT, &input) == 0;
  }

  /// False if there is no such control, or it refuses the value.
  [[nodiscard]] bool set(const std::string& name, int value) const {
    const auto range = find(name);
    if (!range) return false;
    v4l2_control control{.id = range->id, .value = value};
    return ::ioctl(fd_, VIDIOC_S_CTRL, &control) == 0;
  }

  /// Chooses an entry of a menu by its text.
  [[nodiscard]] bool choose(const std::string& name, const std::string& entry) const {
    const auto range = find(name);
    if (!range) return false;
    for (int i = range->minimum; i <= range->maximum; ++i) {
      v4l2_querymenu menu{};
      menu.id = range->id;
      menu.index = static_cast<unsigned>(i);
      if (::ioctl(fd_, VIDIOC_QUERYMENU, &menu) != 0) continue;
      if (reinterpret_cast<const char*>(menu.name) == entry) return set(name, i);
    }
    return false;
  }

  [[nodiscard]] std::optional<int> value(const std::string& name) const {
    const auto range = find(name);
    if (!range) return std::nullopt;
    v4l2_control control{.id = range->id, .value = 0};
    if (::ioctl(fd_, VIDIOC_G_CTRL, &control) != 0) return std::nullopt;
    return control.value;
  }

 private:
  [[nodiscard]] std::optional<v4l2_queryctrl> find(const std::string& name) const {
    v4l2_queryctrl control{};
    control.id = V4L2_CTRL_FLAG_NEXT_CTRL;
    while (::ioctl(fd_, VIDIOC_QUERYCTRL, &control) == 0) {
      if (reinterpret_cast<const char*>(control.name) == name) return control;
      control.id |= V4L2_CTRL_FLAG_NEXT_CTRL;
    }
    return std::nullopt;
  }

  int fd_;
};

}  // namespace corvid::vm
