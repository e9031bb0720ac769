#include "io/camera/v4l2_device.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>

namespace corvid {
namespace {

/// No driver lists more of anything; one that never ends its list is not believed.
constexpr std::uint32_t kMostEntries = 1000;

// The driver's strings fill their fields up to the end, or end with a zero.
template <std::size_t kSize>
std::string text_of(const __u8 (&field)[kSize]) {
  const auto* begin = reinterpret_cast<const char*>(field);
  return {begin, strnlen(begin, kSize)};
}

std::string list_of_nodes() {
  std::string list;
  for (const auto& [node, name] : v4l2_nodes()) {
    list += fmt::format("{}{} ({})", list.empty() ? "" : ", ", node, name);
  }
  return list.empty() ? "no camera is connected, or its driver is not loaded"
                      : "there are: " + list + "; corvid cameras tells more";
}

Error open_fault(int error, const std::string& path) {
  switch (error) {
    case ENOENT:
      return {ErrorCode::not_found, "there is no such device", path, list_of_nodes()};
    case EACCES:
    case EPERM:
      return {ErrorCode::io, "no permission to open the camera", path,
              "add yourself to the group video: sudo usermod -aG video $USER, and log in again"};
    case EBUSY:
      return {ErrorCode::io, "the camera is in use by another program", path,
              fmt::format("fuser -v {} tells which", path)};
    case ENODEV:
    case ENXIO:
      return {ErrorCode::io, "the camera is gone", path, "plug it in again"};
    default:
      return {ErrorCode::io, fmt::format("the camera cannot be opened: {}", std::strerror(error)),
              path, ""};
  }
}

}  // namespace

Expected<V4l2Device> V4l2Device::open(const std::string& path) {
  int fd = -1;
  do {
    fd = ::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  } while (fd < 0 && errno == EINTR);
  if (fd < 0) return tl::unexpected(open_fault(errno, path));
  V4l2Device device(fd, path);
  v4l2_capability capability{};
  if (const int error = device.call(VIDIOC_QUERYCAP, &capability)) {
    if (error == ENODEV) return tl::unexpected(open_fault(error, path));
    return fail(ErrorCode::unsupported, "this is no V4L2 device", path, list_of_nodes());
  }
  device.name_ = text_of(capability.card);
  device.driver_ = text_of(capability.driver);
  const std::uint32_t can = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0
                                ? capability.device_caps
                                : capability.capabilities;
  device.multiplanar_ = (can & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0;
  if (!device.multiplanar_ && (can & V4L2_CAP_VIDEO_CAPTURE) == 0) {
    return fail(ErrorCode::unsupported,
                fmt::format("the device ({}) does not capture pictures", device.name_), path,
                device.driver_ == kLoopbackDriver ? "start the program that writes to it first"
                                                  : list_of_nodes());
  }
  if ((can & V4L2_CAP_STREAMING) == 0) {
    return fail(ErrorCode::unsupported,
                fmt::format("the device ({}) has no streaming with mapped buffers", device.name_),
                path, list_of_nodes());
  }
  return device;
}

int V4l2Device::call(unsigned long request, void* argument) const {
  while (::ioctl(fd(), request, argument) != 0) {
    if (errno != EINTR) return errno;
  }
  return 0;
}

std::vector<std::uint32_t> V4l2Device::formats() const {
  std::vector<std::uint32_t> formats;
  for (std::uint32_t i = 0; i < kMostEntries; ++i) {
    v4l2_fmtdesc entry{};
    entry.index = i;
    entry.type = buffer_type();
    if (call(VIDIOC_ENUM_FMT, &entry) != 0) break;
    formats.push_back(entry.pixelformat);
  }
  return formats;
}

V4l2Sizes V4l2Device::sizes(std::uint32_t fourcc) const {
  V4l2Sizes sizes;
  for (std::uint32_t i = 0; i < kMostEntries; ++i) {
    v4l2_frmsizeenum entry{};
    entry.index = i;
    entry.pixel_format = fourcc;
    if (call(VIDIOC_ENUM_FRAMESIZES, &entry) != 0) break;
    if (entry.type != V4L2_FRMSIZE_TYPE_DISCRETE) {
      const v4l2_frmsize_stepwise& range = entry.stepwise;
      sizes.listed = {{static_cast<int>(range.max_width), static_cast<int>(range.max_height)}};
      sizes.range = true;
      sizes.least_width_px = static_cast<int>(range.min_width);
      sizes.least_height_px = static_cast<int>(range.min_height);
      sizes.step_width_px = static_cast<int>(std::max(range.step_width, 1u));
      sizes.step_height_px = static_cast<int>(std::max(range.step_height, 1u));
      break;
    }
    sizes.listed.emplace_back(entry.discrete.width, entry.discrete.height);
  }
  return sizes;
}

V4l2Intervals V4l2Device::intervals(std::uint32_t fourcc, int width_px, int height_px) const {
  V4l2Intervals intervals;
  for (std::uint32_t i = 0; i < kMostEntries; ++i) {
    v4l2_frmivalenum entry{};
    entry.index = i;
    entry.pixel_format = fourcc;
    entry.width = static_cast<std::uint32_t>(width_px);
    entry.height = static_cast<std::uint32_t>(height_px);
    if (call(VIDIOC_ENUM_FRAMEINTERVALS, &entry) != 0) break;
    if (entry.type != V4L2_FRMIVAL_TYPE_DISCRETE) {
      intervals.listed = {entry.stepwise.min, entry.stepwise.max};
      intervals.range = true;
      break;
    }
    intervals.listed.push_back(entry.discrete);
  }
  std::erase_if(intervals.listed, [](const v4l2_fract& f) { return rate_of(f) <= 0; });
  std::sort(intervals.listed.begin(), intervals.listed.end(),
            [](const v4l2_fract& a, const v4l2_fract& b) { return rate_of(a) > rate_of(b); });
  return intervals;
}

// Freeing the buffers that one does not have is refused only where somebody else has some.
bool V4l2Device::in_use() const {
  if (driver_ == kLoopbackDriver) return false;  // any number may read; the call would disturb them
  v4l2_requestbuffers none{};
  none.type = buffer_type();
  none.memory = V4L2_MEMORY_MMAP;
  return call(VIDIOC_REQBUFS, &none) == EBUSY;
}

Error V4l2Device::fault(int error, const std::string& what) const {
  if (error == EBUSY || error == ENODEV || error == ENXIO) return open_fault(error, path_);
  return {ErrorCode::io, fmt::format("{}: {}", what, std::strerror(error)),
          fmt::format("{} ({})", path_, name_), ""};
}

std::vector<std::pair<std::string, std::string>> v4l2_nodes() {
  std::vector<std::pair<int, std::string>> numbers;
  std::error_code gone;  // devices come and go while we look
  for (std::filesystem::directory_iterator entry("/sys/class/video4linux", gone), end;
       !gone && entry != end; entry.increment(gone)) {
    const std::string node = entry->path().filename().string();
    if (!node.starts_with("video")) continue;  // v4l-subdev0, vbi0, radio0
    std::string name;
    std::ifstream file(entry->path() / "name");
    std::getline(file, name);
    numbers.emplace_back(std::atoi(node.c_str() + 5), name);
  }
  std::sort(numbers.begin(), numbers.end());
  std::vector<std::pair<std::string, std::string>> nodes;
  for (auto& [number, name] : numbers) {
    nodes.emplace_back(fmt::format("/dev/video{}", number), std::move(name));
  }
  return nodes;
}

v4l2_fract interval_of(double rate_hz) {
  // NTSC's rates are n * 1000 / 1001.
  const double ntsc = rate_hz * 1.001;
  if (std::abs(ntsc - std::round(ntsc)) < 1e-3 && std::abs(rate_hz - std::round(rate_hz)) > 1e-3) {
    return {1001, static_cast<std::uint32_t>(std::lround(ntsc)) * 1000};
  }
  if (rate_hz < 1) return {static_cast<std::uint32_t>(std::lround(1000 / rate_hz)), 1000};
  if (std::abs(rate_hz - std::round(rate_hz)) < 1e-9) {
    return {1, static_cast<std::uint32_t>(std::lround(rate_hz))};
  }
  return {1000, static_cast<std::uint32_t>(std::lround(rate_hz * 1000))};
}

double rate_of(const v4l2_fract& interval) {
  if (interval.numerator == 0) return 0;
  return static_cast<double>(interval.denominator) / interval.numerator;
}

}  // namespace corvid
