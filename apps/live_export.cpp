#include "apps/live_export.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <map>
#include <string>
#include <utility>

#include "core/log.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
constexpr int kPoll_ms = 100;
constexpr int kPatience_s = 30;                      // for a peer that neither reads nor writes
constexpr std::uint32_t kMaxPacketBytes = 1U << 30;  // what is longer is not from us
constexpr std::uint32_t kNoMapping = 0xFFFFFFFF;     // instead of a packet's length

struct Address {
  sockaddr_un value{};
  socklen_t size = 0;
};

/// An abstract name (it begins with a zero byte) that says whose run to which folder it is.
Address address_of(const fs::path& run_dir) {
  std::error_code ec;
  fs::path whole = fs::weakly_canonical(fs::absolute(run_dir, ec), ec);
  if (whole.filename().empty()) whole = whole.parent_path();  // a slash at the end
  std::uint64_t hash = 0xCBF29CE484222325ULL;                 // FNV-1a
  for (const char c : whole.string())
    hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001B3ULL;
  const std::string name = fmt::format("corvid-live-{}-{:016x}", ::getuid(), hash);
  Address address;
  address.value.sun_family = AF_UNIX;
  std::memcpy(address.value.sun_path + 1, name.data(), name.size());
  address.size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + 1 + name.size());
  return address;
}

void set_patience(int fd, int seconds) {
  const timeval patience{seconds, 0};
  ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof(patience));
  ::setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof(patience));
}

bool same_user(int fd) {
  ucred peer{};
  socklen_t size = sizeof(peer);
  return ::getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0 && peer.uid == ::getuid();
}

bool send_all(int fd, std::string_view bytes, const std::stop_token& stop) {
  while (!bytes.empty() && !stop.stop_requested()) {
    const ssize_t n = ::send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
  return bytes.empty();
}

bool receive_all(int fd, char* to, std::size_t size) {
  while (size > 0) {
    const ssize_t n = ::recv(fd, to, size, 0);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    to += n;
    size -= static_cast<std::size_t>(n);
  }
  return true;
}

/// Every packet with its length before it, then a length of 0; kNoMapping without a stream.
void send_surface(int fd, const MeshStream* stream, const std::stop_token& stop) {
  const auto send_size = [&](std::uint32_t size) {
    return send_all(fd, {reinterpret_cast<const char*>(&size), sizeof(size)}, stop);
  };
  if (!stream) {
    (void)send_size(kNoMapping);
    return;
  }
  for (const MeshPacket& packet : stream->snapshot()) {
    const std::string bytes = encode_packet(packet);
    if (!send_size(static_cast<std::uint32_t>(bytes.size())) || !send_all(fd, bytes, stop)) return;
  }
  (void)send_size(0);
}

/// Joins blocks to one mesh; equal positions become one vertex.
class Welder {
 public:
  void add(const TriangleMesh& block) {
    std::vector<std::uint32_t> renamed;
    for (std::size_t i = 0; i < block.vertices.size(); ++i) {
      const Eigen::Vector3f& v = block.vertices[i];
      const auto [it, is_new] = vertex_at_.try_emplace(
          {v.x(), v.y(), v.z()}, static_cast<std::uint32_t>(mesh.vertices.size()));
      if (is_new) {
        mesh.vertices.push_back(v);
        mesh.normals.push_back(block.normals.empty() ? Eigen::Vector3f(0, 0, 1) : block.normals[i]);
        mesh.colours.push_back(block.colours.empty() ? Rgb8{128, 128, 128} : block.colours[i]);
      }
      renamed.push_back(it->second);
    }
    for (const auto& t : block.triangles)
      mesh.triangles.push_back({renamed[t[0]], renamed[t[1]], renamed[t[2]]});
  }
  TriangleMesh mesh;

 private:
  std::map<std::array<float, 3>, std::uint32_t> vertex_at_;
};

}  // namespace

std::unique_ptr<LiveExportServer> LiveExportServer::start(const fs::path& run_dir,
                                                          const MeshStream* stream) {
  Descriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const Address address = address_of(run_dir);
  if (socket.get() < 0 ||
      ::bind(socket.get(), reinterpret_cast<const sockaddr*>(&address.value), address.size) != 0 ||
      ::listen(socket.get(), 4) != 0) {
    log().info("`corvid export {}` has to wait for the end of this run: {}", run_dir.string(),
               std::strerror(errno));
    return nullptr;
  }
  return std::unique_ptr<LiveExportServer>(new LiveExportServer(socket.release(), stream));
}

LiveExportServer::LiveExportServer(int fd, const MeshStream* stream)
    : fd_(fd), thread_([fd, stream](const std::stop_token& stop) {
        while (!stop.stop_requested()) {
          pollfd waiting{fd, POLLIN, 0};
          if (::poll(&waiting, 1, kPoll_ms) <= 0) continue;
          const Descriptor client(::accept4(fd, nullptr, nullptr, SOCK_CLOEXEC));
          if (client.get() < 0) {  // too many open files, most likely: who waits goes on waiting
            std::this_thread::sleep_for(std::chrono::milliseconds(kPoll_ms));
            continue;
          }
          if (!same_user(client.get())) continue;
          set_patience(client.get(), 1);  // a stuck reader must not hold up the end of the run
          send_surface(client.get(), stream, stop);
        }
      }) {}

LiveExportServer::~LiveExportServer() {
  thread_.request_stop();
  thread_.join();
}

Expected<std::optional<TriangleMesh>> fetch_live_surface(const fs::path& run_dir) {
  const Descriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  if (socket.get() < 0) return fail(ErrorCode::io, std::strerror(errno), run_dir.string());
  set_patience(socket.get(), kPatience_s);  // for the connection, too: the server may be busy
  const Address address = address_of(run_dir);
  if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address.value), address.size) !=
      0) {
    if (errno != EAGAIN) return std::nullopt;
    return fail(ErrorCode::io, "the running engine does not answer", run_dir.string(), "try again");
  }
  if (!same_user(socket.get())) return std::nullopt;  // anybody can take such a name
  Welder welder;
  for (;;) {
    std::uint32_t size = 0;
    std::string bytes;
    if (receive_all(socket.get(), reinterpret_cast<char*>(&size), sizeof(size))) {
      if (size == 0) return std::optional(std::move(welder.mesh));
      if (size == kNoMapping)
        return fail(ErrorCode::not_found, "the run that goes on maps nothing", run_dir.string(),
                    "it was started with --no-mapping (mapping.enabled = false)");
      if (size <= kMaxPacketBytes) bytes.resize(size);
    }
    if (bytes.empty() || !receive_all(socket.get(), bytes.data(), size))
      return fail(ErrorCode::io, "the running engine broke off", run_dir.string(),
                  "it may have ended: try again");
    const auto packet = decode_packet(bytes);
    if (!packet) return tl::unexpected(packet.error());
    const auto block = decode_mesh(*packet);
    if (!block) return tl::unexpected(block.error());
    welder.add(*block);
  }
}

}  // namespace corvid
