#pragma once

#include <linux/videodev2.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "corvid/error.h"
#include "io/descriptor.h"

namespace corvid {

/// The driver that hands on what another program writes (v4l2loopback).
inline constexpr const char* kLoopbackDriver = "v4l2 loopback";

/// Rates that a mode can run at, as frame intervals [s] in fractions.
struct V4l2Intervals {
  std::vector<v4l2_fract> listed;  ///< shortest first; of a range, its ends
  bool range = false;
};

/// Sizes of a format: listed ones, or a range in steps.
struct V4l2Sizes {
  std::vector<std::pair<int, int>> listed;  ///< width, height [px]; of a range, the largest
  bool range = false;
  int least_width_px = 0, least_height_px = 0, step_width_px = 1, step_height_px = 1;
};

/// An open V4L2 node that captures pictures, with one plane per buffer or more.
class V4l2Device {
 public:
  /// Errors as of open_v4l2().
  [[nodiscard]] static Expected<V4l2Device> open(const std::string& path);

  /// An ioctl, again where a signal came in between. 0, or errno.
  [[nodiscard]] int call(unsigned long request, void* argument) const;
  [[nodiscard]] int fd() const { return fd_.get(); }
  [[nodiscard]] const std::string& path() const { return path_; }
  [[nodiscard]] const std::string& name() const { return name_; }
  [[nodiscard]] const std::string& driver() const { return driver_; }
  [[nodiscard]] bool multiplanar() const { return multiplanar_; }
  [[nodiscard]] std::uint32_t buffer_type() const {
    return multiplanar_ ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
  }
  /// FourCCs in the driver's order.
  [[nodiscard]] std::vector<std::uint32_t> formats() const;
  [[nodiscard]] V4l2Sizes sizes(std::uint32_t fourcc) const;
  [[nodiscard]] V4l2Intervals intervals(std::uint32_t fourcc, int width_px, int height_px) const;
  /// Whether another program holds its buffers.
  [[nodiscard]] bool in_use() const;
  /// The error of a call that failed: unplugged, in use, or `what` with errno's text.
  [[nodiscard]] Error fault(int error, const std::string& what) const;

 private:
  V4l2Device(int fd, std::string path) : fd_(fd), path_(std::move(path)) {}
  Descriptor fd_;
  std::string path_, name_, driver_;
  bool multiplanar_ = false;
};

/// The nodes below /dev that V4L2 registered as video devices ("/dev/video0"), by number, with the
/// names that their drivers gave them.
[[nodiscard]] std::vector<std::pair<std::string, std::string>> v4l2_nodes();

/// `rate_hz` as a frame interval: 29.97 is 1001/30000 s.
[[nodiscard]] v4l2_fract interval_of(double rate_hz);
/// 0 for an interval that is none.
[[nodiscard]] double rate_of(const v4l2_fract& interval);

}  // namespace corvid
