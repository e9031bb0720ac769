#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

/// The device's end of a USB cable whose other end is the kernel's vhci-hcd: USB/IP's wire format
/// over a socket pair, see Documentation/usb/usbip_protocol.rst.
namespace corvid::vm {

constexpr int kStall = -32;  ///< -EPIPE: the endpoint refuses

/// A transfer that the host asks for.
struct UsbRequest {
  std::uint32_t sequence = 0;
  bool unlink = false;       ///< the transfer `victim` is not wanted any more
  std::uint32_t victim = 0;  ///< unlink
  bool to_host = false;
  std::uint32_t endpoint = 0;
  std::uint32_t length = 0;
  std::uint8_t setup[8] = {};      ///< endpoint 0
  std::vector<std::uint8_t> data;  ///< from the host
};

class UsbCable {
 public:
  /// Plugs a high-speed device into a port of vhci-hcd; waits while the port is still in use by the
  /// device before. Ends the program where that does not work. Destruction unplugs.
  explicit UsbCable(int port);
  UsbCable(const UsbCable&) = delete;
  UsbCable& operator=(const UsbCable&) = delete;
  ~UsbCable();

  [[nodiscard]] int fd() const { return socket_; }
  /// Blocks until a whole request is there; ends the program where the host has closed the port.
  [[nodiscard]] UsbRequest receive();
  /// Answers a transfer: a status (0 or a negative errno), the bytes for the host, and how many
  /// were moved in either direction.
  void reply(std::uint32_t sequence, int status, const std::vector<std::uint8_t>& data,
             std::size_t moved);
  void reply_unlink(std::uint32_t sequence, int status);

 private:
  void send(std::uint32_t kind, std::uint32_t sequence, int status,
            const std::vector<std::uint8_t>& data, std::size_t moved);
  void read_all(void* to, std::size_t size);

  int socket_ = -1;
};

}  // namespace corvid::vm
