// corvid_sample_mavlink write PACKETS JSON: writes packets as a link sends them, and what is in
// them. corvid_sample_mavlink reencode IN OUT: reads packets, and writes what it understood.
#include <cmath>
#include <fstream>
#include <iostream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string_view>
#include <type_traits>
#include <vector>

#include "io/mavlink/node.h"
#include "io/mavlink/packet.h"

namespace {

using namespace corvid;
using namespace corvid::mavlink;
using Bytes = std::vector<std::uint8_t>;
using Json = nlohmann::ordered_json;

/// A float as the double that it is; NaN becomes null. 64 bits do not fit into a JSON number.
template <class T>
Json json_of(const T& value) {
  if constexpr (std::is_enum_v<T>) {
    return static_cast<int>(value);
  } else if constexpr (std::is_floating_point_v<T>) {
    return std::isnan(value) ? Json() : Json(static_cast<double>(value));
  } else if constexpr (sizeof(T) == 8 && std::is_integral_v<T>) {
    return std::to_string(value);
  } else if constexpr (std::is_integral_v<T>) {
    return static_cast<std::int64_t>(value);
  } else if constexpr (std::is_same_v<typename T::value_type, char>) {
    return std::string(value.data(), strnlen(value.data(), value.size()));
  } else {
    Json list = Json::array();
    for (const auto& element : value) list.push_back(json_of(element));
    return list;
  }
}

template <class Message>
Json fields_of(const Packet& packet, std::initializer_list<const char*> names) {
  const auto message = unpack<Message>(packet);
  Json fields;
  const auto* name = names.begin();
  Message::fields(message, [&](const auto& field) { fields[*name++] = json_of(field); });
  if (name != names.end()) throw std::logic_error("a name without a field");
  return fields;
}

Json fields_of(const Packet& packet) {
  switch (packet.id) {
    case Heartbeat::kId:
      return fields_of<Heartbeat>(packet, {"custom_mode", "type", "autopilot", "base_mode",
                                           "system_status", "mavlink_version"});
    case GpsRawInt::kId:
      return fields_of<GpsRawInt>(packet, {"time_usec", "lat", "lon", "alt", "eph", "epv", "vel",
                                           "cog", "fix_type", "satellites_visible", "alt_ellipsoid",
                                           "h_acc", "v_acc", "vel_acc", "hdg_acc", "yaw"});
    case Timesync::kId:
      return fields_of<Timesync>(packet, {"tc1", "ts1", "target_system", "target_component"});
    case StatusText::kId:
      return fields_of<StatusText>(packet, {"severity", "text", "id", "chunk_seq"});
    case Odometry::kId:
      return fields_of<Odometry>(
          packet, {"time_usec", "x", "y", "z", "q", "vx", "vy", "vz", "rollspeed", "pitchspeed",
                   "yawspeed", "pose_covariance", "velocity_covariance", "frame_id",
                   "child_frame_id", "reset_counter", "estimator_type", "quality"});
    default:
      throw std::logic_error("unknown message");
  }
}

PoseEvent event_at(int i, const std::shared_ptr<const MapPlacement>& placement) {
  constexpr std::int64_t kStart_ns = 7'000'000'000'000, kInterval_ns = 50'000'000;
  const double t_s = 0.05 * i;
  PoseEvent event;
  event.time_ns = kStart_ns + i * kInterval_ns;
  event.state = i == 0   ? TrackingState::starting
                : i < 40 ? (i % 7 == 0 ? TrackingState::degraded : TrackingState::tracking)
                         : TrackingState::lost;
  event.reason = "the wall is blank, and there is nothing on it to look at";
  if (event.state == TrackingState::starting || event.state == TrackingState::lost) return event;
  event.T_world_camera = Pose(so3_exp({0.3 * t_s, -0.2, 1.1 * std::sin(t_s)}),
                              {2 * t_s, std::sin(t_s), -0.3 * t_s * t_s});
  event.covariance = 1e-3 * Matrix6d::Identity();
  event.covariance(0, 4) = event.covariance(4, 0) = 2e-4;
  event.resets = i < 25 ? 254 : 257;
  if (i < 5) return event;  // no scale yet
  event.scale = MapScale::metric;
  event.placement = placement;
  return event;
}

/// Everything that a link says in two seconds of a flight, and messages of our own making.
std::vector<Bytes> sample_packets() {
  auto placement = std::make_shared<MapPlacement>();
  placement->scale = MapScale::metric;
  placement->T_enu_map = Sim3(3.3, so3_exp({0.1, 0.2, 2.0}), {-12, 30, 55});
  placement->covariance = 1e-4 * Matrix7d::Identity();
  MavlinkNode node({}, nullptr);
  std::vector<Bytes> packets;
  for (int i = 0; i < 70; ++i) {
    const PoseEvent event = event_at(i, placement);
    node.on_pose(event, event.time_ns + 30'000'000);
    if (i % 9 == 0) {
      node.on_bytes(to_bytes(pack(Timesync{0, 123456789 + i, 0, 0}, 3, {1, 1})), true,
                    event.time_ns + 31'000'000);
    }
    for (const int ms : {32, 60}) node.tick(event.time_ns + ms * 1'000'000);
    for (MavlinkOutgoing& packet : node.take_outgoing()) packets.push_back(std::move(packet.bytes));
  }
  GpsRawInt gps;
  gps.time_usec = UINT64_MAX, gps.lat = -INT32_MAX, gps.lon = INT32_MIN, gps.alt = -1;
  gps.h_acc = UINT32_MAX, gps.fix_type = 8;
  packets.push_back(to_bytes(pack(gps, 254, {255, 1})));
  packets.push_back(to_bytes(pack(Timesync{INT64_MAX, INT64_MIN, 0, 1}, 255, {9, 200})));
  // Not one of zeros only: the standard never cuts a payload's first byte, node-mavlink does.
  return packets;
}

Bytes read_file(const char* path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(std::string("cannot be read: ") + path);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write_file(const char* path, std::string_view bytes) {
  std::ofstream file(path, std::ios::binary);
  file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!file.flush()) throw std::runtime_error(std::string("cannot be written: ") + path);
}

std::string_view view(const Bytes& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

void write(const char* packets_path, const char* json_path) {
  Bytes all;
  for (const Bytes& bytes : sample_packets()) all.insert(all.end(), bytes.begin(), bytes.end());
  Json said = Json::array();
  PacketParser parser;
  parser.feed(all, [&](const Packet& packet) {
    said.push_back({{"id", packet.id},
                    {"sequence", packet.sequence},
                    {"system", packet.from.system},
                    {"component", packet.from.component},
                    {"fields", fields_of(packet)}});
  });
  write_file(packets_path, view(all));
  write_file(json_path, said.dump(1));
}

template <class Message>
Bytes again(const Packet& packet) {
  return to_bytes(pack(unpack<Message>(packet), packet.sequence, packet.from));
}

void reencode(const char* in, const char* out) {
  Bytes all;
  PacketParser parser;
  parser.feed(read_file(in), [&](const Packet& packet) {
    const Bytes bytes = packet.id == Heartbeat::kId    ? again<Heartbeat>(packet)
                        : packet.id == GpsRawInt::kId  ? again<GpsRawInt>(packet)
                        : packet.id == Timesync::kId   ? again<Timesync>(packet)
                        : packet.id == StatusText::kId ? again<StatusText>(packet)
                                                       : again<Odometry>(packet);
    all.insert(all.end(), bytes.begin(), bytes.end());
  });
  write_file(out, view(all));
}

}  // namespace

int main(int argc, char** argv) {
  const std::string_view mode = argc == 4 ? argv[1] : "";
  try {
    if (mode == "write") {
      write(argv[2], argv[3]);
    } else if (mode == "reencode") {
      reencode(argv[2], argv[3]);
    } else {
      std::cerr << "usage: corvid_sample_mavlink write PACKETS JSON | reencode IN OUT\n";
      return 2;
    }
  } catch (const std::exception& e) {
    std::cerr << e.what() << "\n";
    return 1;
  }
  return 0;
}
