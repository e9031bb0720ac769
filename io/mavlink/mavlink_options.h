#pragma once

#include <string>
#include <string_view>

#include "corvid/error.h"
#include "io/mavlink/node.h"

namespace corvid {

enum class MavlinkCarrier {
  udp,         ///< to one address; answers come from there
  udp_listen,  ///< waits at a port; the first who speaks is answered
  serial,
};

struct MavlinkOptions {
  MavlinkCarrier carrier = MavlinkCarrier::udp;
  std::string place;     ///< host or address; device
  int port_or_baud = 0;  ///< UDP port; bits per second
  MavlinkNodeOptions node;
};

/// What mavlink_options() reads, for a program's help.
extern const char* const kMavlinkHelp;

/// Reads "udp:HOST:PORT", "udpin:[ADDRESS:]PORT" or "serial:DEVICE[:BAUD]", then options separated
/// by commas: "udp:127.0.0.1:14550,mount=down,rate=50". Errors: invalid_argument.
[[nodiscard]] Expected<MavlinkOptions> mavlink_options(std::string_view spec);

}  // namespace corvid
