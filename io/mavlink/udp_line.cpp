#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstring>
#include <optional>

#include "io/descriptor.h"
#include "io/mavlink/line.h"

namespace corvid {
namespace {

/// An address of any family.
struct Address {
  sockaddr_storage storage{};
  socklen_t length = sizeof(sockaddr_storage);
  [[nodiscard]] sockaddr* get() { return reinterpret_cast<sockaddr*>(&storage); }
  [[nodiscard]] const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&storage); }
  [[nodiscard]] bool operator==(const Address& o) const {
    return length == o.length && std::memcmp(&storage, &o.storage, length) == 0;
  }
};

class UdpLine final : public MavlinkLine {
 public:
  explicit UdpLine(const MavlinkOptions& options)
      : host_(options.place),
        port_(options.port_or_baud),
        listens_(options.carrier == MavlinkCarrier::udp_listen) {}

  Expected<void> open() override;
  void close() override { socket_.reset(-1); }
  int descriptor() const override { return socket_.get(); }
  bool datagrams() const override { return true; }
  Expected<std::size_t> read(std::span<std::uint8_t> bytes) override;
  Expected<bool> write(std::span<const std::uint8_t> packet) override;
  void partner_speaks(std::int64_t now_ns) override;
  int local_port() const override;

 private:
  static constexpr std::int64_t kSilence_ns = 5'000'000'000;  // then another may be the partner

  /// Asks the resolver, which may take long, and so only once; IPv4 first, as autopilots speak it.
  Expected<void> resolve();
  std::string where() const { return fmt::format("{}:{}", host_, port_); }

  std::string host_;
  int port_;
  bool listens_;
  std::optional<Address> address_;  ///< of host and port
  Descriptor socket_;
  Address last_sender_;
  std::optional<Address> partner_;
  std::int64_t partner_spoke_ns_ = 0;
};

/// What goes away by itself: nobody listens there yet, the network is down.
bool passes(int error) {
  return error == EAGAIN || error == EWOULDBLOCK || error == EINTR || error == ECONNREFUSED ||
         error == ENETUNREACH || error == EHOSTUNREACH || error == ENETDOWN || error == ENOBUFS ||
         error == EHOSTDOWN || error == EPERM;
}

Expected<void> UdpLine::resolve() {
  addrinfo hints{}, *found = nullptr;
  hints.ai_socktype = SOCK_DGRAM;
  hints.ai_flags = AI_NUMERICSERV | (listens_ ? AI_PASSIVE : 0);
  const int status = getaddrinfo(host_.c_str(), std::to_string(port_).c_str(), &hints, &found);
  if (status != 0) {
    return fail(ErrorCode::not_found,
                fmt::format("the host cannot be found: {}", gai_strerror(status)), where(),
                "check the name, or give the address");
  }
  const std::unique_ptr<addrinfo, void (*)(addrinfo*)> addresses(found, freeaddrinfo);
  const addrinfo* chosen = found;
  while (chosen != nullptr && chosen->ai_family != AF_INET) chosen = chosen->ai_next;
  if (chosen == nullptr) chosen = found;
  address_.emplace();
  std::memcpy(&address_->storage, chosen->ai_addr, chosen->ai_addrlen);
  address_->length = chosen->ai_addrlen;
  return {};
}

Expected<void> UdpLine::open() {
  if (!address_) {
    if (auto resolved = resolve(); !resolved) return resolved;
  }
  const Address& at = *address_;
  socket_.reset(::socket(at.storage.ss_family, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  const int fd = socket_.get();
  if (fd < 0 ||
      (listens_ ? ::bind(fd, at.get(), at.length) : ::connect(fd, at.get(), at.length)) != 0) {
    const int error = errno;
    socket_.reset(-1);
    return fail(ErrorCode::io, fmt::format("the UDP port cannot be opened: {}", strerror(error)),
                where(),
                error == EADDRINUSE ? "another program listens there; choose another port" : "");
  }
  partner_.reset();
  return {};
}

Expected<std::size_t> UdpLine::read(std::span<std::uint8_t> bytes) {
  last_sender_ = Address{};
  const ssize_t n = ::recvfrom(socket_.get(), bytes.data(), bytes.size(), 0, last_sender_.get(),
                               &last_sender_.length);
  if (n >= 0) return static_cast<std::size_t>(n);
  if (passes(errno)) return 0;
  return fail(ErrorCode::io, fmt::format("reading failed: {}", strerror(errno)), where());
}

Expected<bool> UdpLine::write(std::span<const std::uint8_t> packet) {
  if (listens_ && !partner_) return false;
  const ssize_t n = listens_ ? ::sendto(socket_.get(), packet.data(), packet.size(), MSG_NOSIGNAL,
                                        partner_->get(), partner_->length)
                             : ::send(socket_.get(), packet.data(), packet.size(), MSG_NOSIGNAL);
  if (n >= 0) return true;
  if (passes(errno)) return false;
  return fail(ErrorCode::io, fmt::format("sending failed: {}", strerror(errno)), where());
}

void UdpLine::partner_speaks(std::int64_t now_ns) {
  if (!listens_) return;
  if (!partner_ || now_ns - partner_spoke_ns_ > kSilence_ns) partner_ = last_sender_;
  if (*partner_ == last_sender_) partner_spoke_ns_ = now_ns;
}

int UdpLine::local_port() const {
  Address own;
  if (::getsockname(socket_.get(), own.get(), &own.length) != 0) return 0;
  // The port lies at the same place in both families' addresses.
  sockaddr_in ip{};
  std::memcpy(&ip, &own.storage, sizeof ip);
  return ntohs(ip.sin_port);
}

}  // namespace

std::unique_ptr<MavlinkLine> udp_line(const MavlinkOptions& options) {
  return std::make_unique<UdpLine>(options);
}

}  // namespace corvid
