#pragma once

#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <string>

namespace corvid::vm {

/// The writing end of a v4l2loopback device: grey pictures of one size.
class LoopbackWriter {
 public:
  /// @param interval_s  between pictures, as readers are told; 0: they are told the driver's own.
  LoopbackWriter(const std::string& node, int width_px, int height_px, unsigned interval_s = 0)
      : fd_(::open(node.c_str(), O_RDWR | O_CLOEXEC)) {
    v4l2_format format{};
    format.type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    format.fmt.pix.width = static_cast<unsigned>(width_px);
    format.fmt.pix.height = static_cast<unsigned>(height_px);
    format.fmt.pix.pixelformat = V4L2_PIX_FMT_GREY;
    format.fmt.pix.field = V4L2_FIELD_NONE;
    ready_ = ::ioctl(fd_, VIDIOC_S_FMT, &format) == 0;
    if (interval_s == 0) return;
    v4l2_streamparm rate{};
    rate.type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    rate.parm.output.timeperframe = {interval_s, 1};
    ready_ = ready_ && ::ioctl(fd_, VIDIOC_S_PARM, &rate) == 0;
  }
  LoopbackWriter(const LoopbackWriter&) = delete;
  LoopbackWriter& operator=(const LoopbackWriter&) = delete;
  ~LoopbackWriter() { ::close(fd_); }

  /// False if the device does not take the picture, `width_px` * `height_px` bytes, as a whole.
  [[nodiscard]] bool write(const std::uint8_t* luma, std::size_t size) const {
    return ready_ && ::write(fd_, luma, size) == static_cast<ssize_t>(size);
  }

 private:
  int fd_;
  bool ready_ = false;
};

}  // namespace corvid::vm
