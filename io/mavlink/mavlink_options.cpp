#include "io/mavlink/mavlink_options.h"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <cmath>
#include <numbers>
#include <optional>
#include <vector>

#include "io/nearest_name.h"

namespace corvid {
namespace {

constexpr int kDefaultBaud = 921600;  // of the port for companion computers in PX4 and ArduPilot

std::vector<std::string> split(std::string_view text, char at) {
  std::vector<std::string> parts(1);
  for (const char c : text) {
    if (c == at) {
      parts.emplace_back();
    } else {
      parts.back() += c;
    }
  }
  return parts;
}

/// The whole text as a number that is finite.
template <class Number>
std::optional<Number> number(std::string_view text) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  if (!std::isfinite(static_cast<double>(value))) return std::nullopt;
  return value;
}

std::optional<Eigen::Vector3d> three_numbers(std::string_view text) {
  const std::vector<std::string> parts = split(text, '/');
  if (parts.size() != 3) return std::nullopt;
  Eigen::Vector3d v;
  for (int i = 0; i < 3; ++i) {
    const auto value = number<double>(parts[static_cast<std::size_t>(i)]);
    if (!value) return std::nullopt;
    v[i] = *value;
  }
  return v;
}

/// Splits at the last colon; the second part is empty if there is none.
std::pair<std::string, std::string> last_colon(std::string_view text) {
  const std::size_t at = text.rfind(':');
  if (at == std::string_view::npos) return {std::string(text), ""};
  return {std::string(text.substr(0, at)), std::string(text.substr(at + 1))};
}

/// @return what is wrong; empty if nothing is.
std::string read_address(std::string_view address, MavlinkOptions* out) {
  const std::size_t colon = address.find(':');
  const std::string_view kind = address.substr(0, colon);
  const std::string_view rest =
      colon == std::string_view::npos ? std::string_view() : address.substr(colon + 1);
  if (kind == "serial") {
    out->carrier = MavlinkCarrier::serial;
    auto [device, baud] = last_colon(rest);
    // Names under /dev/serial/by-path have colons, too.
    const auto rate = number<int>(baud);
    out->place = rate ? device : std::string(rest);
    out->port_or_baud = rate.value_or(kDefaultBaud);
    if (out->place.empty()) return "the device is missing";
    return out->port_or_baud > 0 ? "" : "the rate of a serial line is positive";
  }
  if (kind != "udp" && kind != "udpin") return fmt::format("unknown kind of link '{}'", kind);
  out->carrier = kind == "udp" ? MavlinkCarrier::udp : MavlinkCarrier::udp_listen;
  auto [host, port] = last_colon(rest);
  if (out->carrier == MavlinkCarrier::udp_listen && port.empty()) {
    port = std::exchange(host, "0.0.0.0");
  }
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  }
  const auto value = number<int>(port);
  const int least = out->carrier == MavlinkCarrier::udp ? 1 : 0;
  if (host.empty()) return "the host is missing";
  if (!value || *value < least || *value > 65535) {
    return fmt::format("'{}' is not a port from 1 to 65535", port);
  }
  out->place = host;
  out->port_or_baud = *value;
  return {};
}

std::optional<Eigen::Quaterniond> read_mount(std::string_view text) {
  constexpr double kRadians = std::numbers::pi / 180;
  if (text == "forward") return camera_mount(0, 0, 0);
  if (text == "down") return camera_mount(0, -90 * kRadians, 0);
  const auto degrees = three_numbers(text);
  if (!degrees) return std::nullopt;
  return camera_mount(kRadians * degrees->x(), kRadians * degrees->y(), kRadians * degrees->z());
}

/// @return what is wrong; empty if nothing is.
std::string read_option(const std::string& key, const std::string& text, MavlinkOptions* out) {
  MavlinkNodeOptions& node = out->node;
  Pose& mount = node.odometry.T_body_camera;
  const auto value = number<double>(text);
  if (key == "mount") {
    const auto q = read_mount(text);
    if (!q) return fmt::format("mount: '{}' is not forward, down or ROLL/PITCH/YAW [deg]", text);
    mount = Pose(*q, mount.translation());
  } else if (key == "lever") {
    const auto lever_m = three_numbers(text);
    if (!lever_m || lever_m->norm() > 1000) {
      return fmt::format("lever: '{}' is not FORWARD/RIGHT/DOWN [m]", text);
    }
    mount = Pose(mount.rotation(), *lever_m);
  } else if (key == "rate") {
    if (!value || *value < 0 || *value > 200) return "rate: a number from 0 to 200 [Hz]";
    node.odometry.rate_hz = *value;
  } else if (key == "frame") {
    if (text != "frd" && text != "ned") return fmt::format("frame: '{}' is not frd or ned", text);
    node.odometry.frame = text == "frd" ? mavlink::Frame::local_frd : mavlink::Frame::local_ned;
  } else if (key == "gps_delay") {
    if (!value || *value < 0 || *value > 5) return "gps_delay: a number from 0 to 5 [s]";
    node.gps_delay_s = *value;
  } else if (key == "system") {
    const auto id = number<int>(text);
    if (!id || *id < 1 || *id > 255) return "system: a whole number from 1 to 255";
    node.station.system = static_cast<std::uint8_t>(*id);
  } else if (key == "component") {
    const auto id = number<int>(text);
    if (!id || *id < 1 || *id > 255) return "component: a whole number from 1 to 255";
    node.station.component = static_cast<std::uint8_t>(*id);
  } else {
    const std::array<std::string, 7> keys{"mount",     "lever",  "rate",     "frame",
                                          "gps_delay", "system", "component"};
    return fmt::format("unknown option '{}' {}", key, nearest_hint(key, keys));
  }
  return {};
}

}  // namespace

const char* const kMavlinkHelp =
    "link to an autopilot: udp:HOST:PORT sends there, udpin:[ADDRESS:]PORT waits for who speaks\n"
    "first (PX4's simulator speaks to 14540, ArduPilot's and most routers to 14550),\n"
    "serial:DEVICE[:BAUD] (921600 if not said). Then, separated by commas:\n"
    "  mount=forward|down|ROLL/PITCH/YAW  how the camera looks [deg, from forward]\n"
    "  lever=FORWARD/RIGHT/DOWN           where it is on the vehicle [m]\n"
    "  rate=HZ         least rate of ODOMETRY; gaps are filled by extrapolation (30; 0: never)\n"
    "  frame=frd|ned   how ODOMETRY calls its frame (frd; ned is for PX4 with a compass or GPS "
    "yaw)\n"
    "  gps_delay=S     from a position to the autopilot's message (0.11)\n"
    "  system=ID       the vehicle's MAVLink id (1); component=ID ours (197)";

Expected<MavlinkOptions> mavlink_options(std::string_view spec) {
  const auto wrong = [&](std::string what) {
    return fail(ErrorCode::invalid_argument, std::move(what), fmt::format("--mavlink {}", spec),
                "for example udp:127.0.0.1:14550 or serial:/dev/ttyAMA0:921600,mount=down");
  };
  MavlinkOptions options;
  const std::vector<std::string> parts = split(spec, ',');
  if (std::string what = read_address(parts[0], &options); !what.empty()) {
    return wrong(std::move(what));
  }
  for (std::size_t i = 1; i < parts.size(); ++i) {
    const std::size_t equals = parts[i].find('=');
    if (equals == std::string::npos) {
      return wrong(fmt::format("'{}' is not of the form option=value", parts[i]));
    }
    if (std::string what =
            read_option(parts[i].substr(0, equals), parts[i].substr(equals + 1), &options);
        !what.empty()) {
      return wrong(std::move(what));
    }
  }
  return options;
}

}  // namespace corvid
