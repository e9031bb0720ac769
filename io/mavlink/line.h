#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "corvid/error.h"
#include "io/mavlink/mavlink_options.h"

namespace corvid {

/// Port: where a link's bytes go. Never waits. One owner.
class MavlinkLine {
 public:
  virtual ~MavlinkLine() = default;
  /// Opens it, anew if it was open. Errors: not_found (no such device or host), io.
  [[nodiscard]] virtual Expected<void> open() = 0;
  virtual void close() = 0;
  /// For poll(2); -1 if it is not open.
  [[nodiscard]] virtual int descriptor() const = 0;
  /// Whether one read is one datagram.
  [[nodiscard]] virtual bool datagrams() const = 0;
  /// Number of bytes read; 0: there are none now. An error means that it must be opened anew.
  [[nodiscard]] virtual Expected<std::size_t> read(std::span<std::uint8_t> bytes) = 0;
  /// Sends the packet as a whole, or says false: nobody is there, or there is no room now. An error
  /// means that it must be opened anew.
  [[nodiscard]] virtual Expected<bool> write(std::span<const std::uint8_t> packet) = 0;
  /// The bytes last read came from one who speaks MAVLink.
  virtual void partner_speaks(std::int64_t /*now_ns*/) {}
  /// The UDP port that it has here; 0 if none.
  [[nodiscard]] virtual int local_port() const { return 0; }
};

[[nodiscard]] std::unique_ptr<MavlinkLine> udp_line(const MavlinkOptions& options);
[[nodiscard]] std::unique_ptr<MavlinkLine> serial_line(const MavlinkOptions& options);

}  // namespace corvid
