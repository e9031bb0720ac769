#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string_view>

namespace corvid::mavlink {

// The messages of MAVLink's common.xml that are understood here. `fields` names a message's fields
// in the order of the wire (by size, extensions last, as declared); kLength includes the
// extensions.

enum class SystemStatus : std::uint8_t { boot = 1, standby = 3, active = 4, critical = 5 };

struct Heartbeat {
  static constexpr std::uint32_t kId = 0;
  static constexpr std::uint8_t kCrcExtra = 50;
  static constexpr std::size_t kLength = 9;
  std::uint32_t custom_mode = 0;
  std::uint8_t type = 18;      ///< MAV_TYPE_ONBOARD_CONTROLLER
  std::uint8_t autopilot = 8;  ///< MAV_AUTOPILOT_INVALID: not an autopilot
  std::uint8_t base_mode = 0;
  SystemStatus system_status = SystemStatus::boot;
  std::uint8_t mavlink_version = 3;
  template <class Self, class Io>
  static void fields(Self& m, Io&& io) {
    io(m.custom_mode), io(m.type), io(m.autopilot), io(m.base_mode), io(m.system_status);
    io(m.mavlink_version);
  }
};

struct GpsRawInt {
  static constexpr std::uint32_t kId = 24;
  static constexpr std::uint8_t kCrcExtra = 24;
  static constexpr std::size_t kLength = 52;
  static constexpr std::uint16_t kUnknown = 65535;  ///< of eph, epv, vel, cog
  std::uint64_t time_usec = 0;                      ///< since the autopilot's start, or Unix time
  std::int32_t lat = 0, lon = 0;                    ///< [1e-7 degrees], WGS84
  std::int32_t alt = 0;                             ///< [mm] above mean sea level
  std::uint16_t eph = kUnknown, epv = kUnknown;     ///< dilution of precision times 100
  std::uint16_t vel = kUnknown, cog = kUnknown;     ///< [cm/s], [0.01 degrees]
  std::uint8_t fix_type = 0;                        ///< 3 and more: a position in three dimensions
  std::uint8_t satellites_visible = 255;
  std::int32_t alt_ellipsoid = 0;          ///< [mm]; here begin the extensions
  std::uint32_t h_acc = 0, v_acc = 0;      ///< uncertainty [mm]; 0: not said
  std::uint32_t vel_acc = 0, hdg_acc = 0;  ///< [mm/s], [1e-5 degrees]
  std::uint16_t yaw = 0;                   ///< [0.01 degrees]; 0: not said
  template <class Self, class Io>
  static void fields(Self& m, Io&& io) {
    io(m.time_usec), io(m.lat), io(m.lon), io(m.alt), io(m.eph), io(m.epv), io(m.vel), io(m.cog);
    io(m.fix_type), io(m.satellites_visible), io(m.alt_ellipsoid), io(m.h_acc), io(m.v_acc);
    io(m.vel_acc), io(m.hdg_acc), io(m.yaw);
  }
};

struct Timesync {
  static constexpr std::uint32_t kId = 111;
  static constexpr std::uint8_t kCrcExtra = 34;
  static constexpr std::size_t kLength = 18;
  std::int64_t tc1 = 0;  ///< [ns] the answerer's time; 0: this is a question
  std::int64_t ts1 = 0;  ///< [ns] the questioner's time
  std::uint8_t target_system = 0, target_component = 0;  ///< 0: everybody
  template <class Self, class Io>
  static void fields(Self& m, Io&& io) {
    io(m.tc1), io(m.ts1), io(m.target_system), io(m.target_component);
  }
};

enum class Severity : std::uint8_t { warning = 4, info = 6 };

struct StatusText {
  static constexpr std::uint32_t kId = 253;
  static constexpr std::uint8_t kCrcExtra = 83;
  static constexpr std::size_t kLength = 54;
  Severity severity = Severity::info;
  std::array<char, 50> text{};  ///< ends with a zero if there is room
  std::uint16_t id = 0;
  std::uint8_t chunk_seq = 0;
  template <class Self, class Io>
  static void fields(Self& m, Io&& io) {
    io(m.severity), io(m.text), io(m.id), io(m.chunk_seq);
  }
  [[nodiscard]] static StatusText of(Severity severity, std::string_view what) {
    StatusText m;
    m.severity = severity;
    what.substr(0, m.text.size()).copy(m.text.data(), m.text.size());
    return m;
  }
};

/// A symmetric 6x6 matrix's upper triangle, row by row. A NaN in front: unknown.
using Covariance21 = std::array<float, 21>;

enum class Frame : std::uint8_t { local_ned = 1, body_frd = 12, local_frd = 20 };

struct Odometry {
  static constexpr std::uint32_t kId = 331;
  static constexpr std::uint8_t kCrcExtra = 91;
  static constexpr std::size_t kLength = 233;
  std::uint64_t time_usec = 0;
  float x = 0, y = 0, z = 0;                              ///< [m] in frame_id
  std::array<float, 4> q{1, 0, 0, 0};                     ///< w x y z: body to frame_id
  float vx = 0, vy = 0, vz = 0;                           ///< [m/s] in child_frame_id
  float rollspeed = 0, pitchspeed = 0, yawspeed = 0;      ///< [rad/s] about the body's axes
  Covariance21 pose_covariance{}, velocity_covariance{};  ///< of (x y z, roll pitch yaw)
  Frame frame_id = Frame::local_frd;
  Frame child_frame_id = Frame::body_frd;
  std::uint8_t reset_counter = 0;
  std::uint8_t estimator_type = 2;  ///< MAV_ESTIMATOR_TYPE_VISION
  std::int8_t quality = 0;          ///< [%] 0 unknown, 1 worst, 100 best; an extension
  template <class Self, class Io>
  static void fields(Self& m, Io&& io) {
    io(m.time_usec), io(m.x), io(m.y), io(m.z), io(m.q), io(m.vx), io(m.vy), io(m.vz);
    io(m.rollspeed), io(m.pitchspeed), io(m.yawspeed), io(m.pose_covariance);
    io(m.velocity_covariance), io(m.frame_id), io(m.child_frame_id), io(m.reset_counter);
    io(m.estimator_type), io(m.quality);
  }
};

}  // namespace corvid::mavlink
