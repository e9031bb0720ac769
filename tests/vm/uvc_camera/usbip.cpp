#include "vm/uvc_camera/usbip.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <string>

namespace corvid::vm {
namespace {

enum : std::uint32_t { kSubmit = 1, kUnlink = 2, kSubmitted = 3, kUnlinked = 4 };
constexpr std::size_t kHeaderWords = 12;
constexpr const char* kAttach = "/sys/devices/platform/vhci_hcd.0/attach";

[[noreturn]] void give_up(const std::string& what) {
  fmt::print(stderr, "uvc_camera: {}: {}\n", what, std::strerror(errno));
  std::exit(1);
}

}  // namespace

UsbCable::UsbCable(int port) {
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM, 0, ends) != 0) give_up("socketpair");
  socket_ = ends[0];
  const int room = 1 << 20;
  ::setsockopt(socket_, SOL_SOCKET, SO_SNDBUF, &room, sizeof room);
  const int attach = ::open(kAttach, O_WRONLY | O_CLOEXEC);
  if (attach < 0) give_up("vhci-hcd's port cannot be opened (modprobe vhci-hcd)");
  constexpr int kHighSpeed = 3;
  const std::string line = fmt::format("{} {} {} {}", port, ends[1], 0x10002 + port, kHighSpeed);
  for (int tries = 0; ::write(attach, line.c_str(), line.size()) < 0; ++tries) {
    if (tries == 600) give_up("vhci-hcd refuses the device");
    ::usleep(100'000);
  }
  ::close(attach);
  ::close(ends[1]);
}

UsbCable::~UsbCable() { ::close(socket_); }

void UsbCable::read_all(void* to, std::size_t size) {
  auto* at = static_cast<char*>(to);
  while (size > 0) {
    const ssize_t got = ::read(socket_, at, size);
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) std::exit(0);
    at += got;
    size -= static_cast<std::size_t>(got);
  }
}

UsbRequest UsbCable::receive() {
  std::array<std::uint32_t, kHeaderWords> header{};
  read_all(header.data(), sizeof header);
  const auto word = [&](std::size_t i) { return ntohl(header[i]); };
  UsbRequest request;
  request.sequence = word(1);
  request.unlink = word(0) == kUnlink;
  if (request.unlink) {
    request.victim = word(5);
    return request;
  }
  request.to_host = word(3) != 0;
  request.endpoint = word(4);
  request.length = word(6);
  std::memcpy(request.setup, &header[10], sizeof request.setup);
  if (!request.to_host) {
    request.data.resize(request.length);
    read_all(request.data.data(), request.data.size());
  }
  return request;
}

void UsbCable::send(std::uint32_t kind, std::uint32_t sequence, int status,
                    const std::vector<std::uint8_t>& data, std::size_t moved) {
  std::array<std::uint32_t, kHeaderWords> header{};
  header[0] = htonl(kind);
  header[1] = htonl(sequence);
  header[5] = htonl(static_cast<std::uint32_t>(status));
  header[6] = htonl(static_cast<std::uint32_t>(moved));
  std::vector<char> bytes(sizeof header + data.size());
  std::memcpy(bytes.data(), header.data(), sizeof header);
  if (!data.empty()) std::memcpy(bytes.data() + sizeof header, data.data(), data.size());
  const char* at = bytes.data();
  for (std::size_t left = bytes.size(); left > 0;) {
    const ssize_t sent = ::send(socket_, at, left, MSG_NOSIGNAL);
    if (sent < 0 && errno == EINTR) continue;
    if (sent <= 0) std::exit(0);
    at += sent;
    left -= static_cast<std::size_t>(sent);
  }
}

void UsbCable::reply(std::uint32_t sequence, int status, const std::vector<std::uint8_t>& data,
                     std::size_t moved) {
  send(kSubmitted, sequence, status, data, moved);
}

void UsbCable::reply_unlink(std::uint32_t sequence, int status) {
  send(kUnlinked, sequence, status, {}, 0);
}

}  // namespace corvid::vm
