#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <vector>

#include "io/descriptor.h"
#include "io/mavlink/line.h"

namespace corvid {
namespace {

struct Rate {
  int baud;
  speed_t code;
};
constexpr std::array kRates{
    Rate{9600, B9600},       Rate{19200, B19200},     Rate{38400, B38400},
    Rate{57600, B57600},     Rate{115200, B115200},   Rate{230400, B230400},
    Rate{460800, B460800},   Rate{500000, B500000},   Rate{576000, B576000},
    Rate{921600, B921600},   Rate{1000000, B1000000}, Rate{1152000, B1152000},
    Rate{1500000, B1500000}, Rate{2000000, B2000000}, Rate{2500000, B2500000},
    Rate{3000000, B3000000}, Rate{3500000, B3500000}, Rate{4000000, B4000000}};

/// A line on which nothing is changed on its way: 8 bits, no parity, one stop bit, no flow control.
Expected<void> make_raw(int fd, speed_t code, const std::string& device) {
  termios settings{};
  if (::tcgetattr(fd, &settings) != 0) {
    return fail(ErrorCode::io, "is not a serial line", device,
                "give a device such as /dev/ttyAMA0");
  }
  ::cfmakeraw(&settings);
  settings.c_cflag |= CLOCAL | CREAD;
  settings.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | CRTSCTS);
  settings.c_cc[VMIN] = 0;
  settings.c_cc[VTIME] = 0;
  ::cfsetispeed(&settings, code);
  ::cfsetospeed(&settings, code);
  if (::tcsetattr(fd, TCSANOW, &settings) != 0) {
    return fail(ErrorCode::io, fmt::format("the rate cannot be set: {}", strerror(errno)), device,
                "choose a rate that the device has");
  }
  ::tcflush(fd, TCIOFLUSH);
  return {};
}

class SerialLine final : public MavlinkLine {
 public:
  explicit SerialLine(const MavlinkOptions& options)
      : device_(options.place), baud_(options.port_or_baud) {}

  Expected<void> open() override;
  void close() override { fd_.reset(-1); }
  int descriptor() const override { return fd_.get(); }
  bool datagrams() const override { return false; }
  Expected<std::size_t> read(std::span<std::uint8_t> bytes) override;
  Expected<bool> write(std::span<const std::uint8_t> packet) override;

 private:
  /// In the driver's queue at most, before another packet: a slow line must not send old poses.
  static constexpr int kMostQueued = 300;

  /// Sends what a write left over. @return whether all of it is gone.
  Expected<bool> send_rest();
  Expected<std::size_t> send_some(std::span<const std::uint8_t> bytes);
  tl::unexpected<Error> gone(const char* doing) const {
    return fail(ErrorCode::io, fmt::format("{} failed: {}", doing, strerror(errno)), device_);
  }

  std::string device_;
  int baud_;
  Descriptor fd_;
  std::vector<std::uint8_t> rest_;  // of a packet that was begun
};

Expected<void> SerialLine::open() {
  std::optional<speed_t> code;
  for (const Rate& rate : kRates) {
    if (rate.baud == baud_) code = rate.code;
  }
  if (!code) {
    return fail(ErrorCode::invalid_argument, fmt::format("{} is not a usual rate", baud_), device_,
                "for example 57600, 115200, 921600, 1500000");
  }
  rest_.clear();
  fd_.reset(::open(device_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  if (fd_.get() < 0) {
    const int error = errno;
    const bool absent = error == ENOENT || error == ENODEV || error == ENXIO;
    const char* hint = "";
    if (absent) hint = "is it plugged in? ls /dev/serial/by-id /dev/ttyA* /dev/ttyS* lists them";
    if (error == EACCES) hint = "join the group dialout: sudo adduser $USER dialout; log in again";
    return fail(absent ? ErrorCode::not_found : ErrorCode::io,
                fmt::format("the serial line cannot be opened: {}", strerror(error)), device_,
                hint);
  }
  if (auto raw = make_raw(fd_.get(), *code, device_); !raw) {
    fd_.reset(-1);
    return raw;
  }
  return {};
}

Expected<std::size_t> SerialLine::read(std::span<std::uint8_t> bytes) {
  const ssize_t n = ::read(fd_.get(), bytes.data(), bytes.size());
  if (n > 0) return static_cast<std::size_t>(n);
  if (n == 0) {
    // Nothing to read and nobody there any more look the same.
    pollfd state{fd_.get(), POLLIN, 0};
    const bool hung_up = ::poll(&state, 1, 0) > 0 && (state.revents & (POLLHUP | POLLERR)) != 0;
    if (hung_up) return fail(ErrorCode::io, "the device is gone", device_);
    return 0;
  }
  if (errno == EAGAIN || errno == EINTR) return 0;
  return gone("reading");
}

Expected<std::size_t> SerialLine::send_some(std::span<const std::uint8_t> bytes) {
  const ssize_t n = ::write(fd_.get(), bytes.data(), bytes.size());
  if (n >= 0) return static_cast<std::size_t>(n);
  if (errno == EAGAIN || errno == EINTR) return 0;
  return gone("writing");
}

Expected<bool> SerialLine::send_rest() {
  if (rest_.empty()) return true;
  const auto sent = send_some(rest_);
  if (!sent) return tl::unexpected(sent.error());
  rest_.erase(rest_.begin(), rest_.begin() + static_cast<std::ptrdiff_t>(*sent));
  return rest_.empty();
}

Expected<bool> SerialLine::write(std::span<const std::uint8_t> packet) {
  const auto free = send_rest();
  if (!free || !*free) return free;
  int queued = 0;
  if (::ioctl(fd_.get(), TIOCOUTQ, &queued) == 0 && queued > kMostQueued) return false;
  const auto sent = send_some(packet);
  if (!sent) return tl::unexpected(sent.error());
  if (*sent == 0) return false;
  rest_.assign(packet.begin() + static_cast<std::ptrdiff_t>(*sent), packet.end());
  return true;
}

}  // namespace

std::unique_ptr<MavlinkLine> serial_line(const MavlinkOptions& options) {
  return std::make_unique<SerialLine>(options);
}

}  // namespace corvid
