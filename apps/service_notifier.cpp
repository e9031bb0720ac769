#include "apps/service_notifier.h"

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <string_view>

#include "core/log.h"

namespace corvid {
namespace {

constexpr std::int64_t kStatusInterval_ns = 2'000'000'000;
/// An hour, for the last adjustment.
constexpr const char* kLastWait = "WATCHDOG_USEC=3600000000";

/// Connected to the manager's socket; -1 if there is none.
int connect_to_manager() {
  const char* const name = std::getenv("NOTIFY_SOCKET");
  sockaddr_un address{};
  if (name == nullptr || (name[0] != '/' && name[0] != '@')) return -1;
  const std::size_t length = std::strlen(name);
  if (length < 2 || length >= sizeof address.sun_path) return -1;
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, name, length);
  if (name[0] == '@') address.sun_path[0] = '\0';  // in the abstract namespace
  const int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + length);
  if (fd >= 0 && connect(fd, reinterpret_cast<const sockaddr*>(&address), size) == 0) return fd;
  log().warn("the service manager at {} cannot be reached: {}", name, std::strerror(errno));
  if (fd >= 0) close(fd);
  return -1;
}

std::int64_t number_in(const char* variable) {
  const char* const text = std::getenv(variable);
  std::int64_t value = 0;
  if (text != nullptr) std::from_chars(text, text + std::strlen(text), value);
  return value;
}

}  // namespace

ServiceNotifier::ServiceNotifier(Clock& clock) : clock_(clock), fd_(connect_to_manager()) {
  const std::int64_t pid = number_in("WATCHDOG_PID");  // of somebody else: not for us
  if (pid == 0 || pid == getpid()) watchdog_ns_ = number_in("WATCHDOG_USEC") * 1000 / 4;
}

ServiceNotifier::~ServiceNotifier() {
  if (fd_ >= 0) close(fd_);
}

bool ServiceNotifier::send(const std::string& message) const {
  return ::send(fd_, message.data(), message.size(), MSG_DONTWAIT | MSG_NOSIGNAL) >= 0;
}

void ServiceNotifier::on_pose(const PoseEvent& event) {
  if (fd_ < 0) return;
  ++frames_;
  const std::int64_t now_ns = clock_.now_ns();
  if (!ready_) ready_ = send("READY=1");
  if (watchdog_ns_ > 0 && (fed_ns_ == 0 || now_ns - fed_ns_ >= watchdog_ns_) &&
      send("WATCHDOG=1")) {
    fed_ns_ = now_ns;
  }
  if ((told_ns_ == 0 || now_ns - told_ns_ >= kStatusInterval_ns) &&
      send(fmt::format("STATUS={}{}{}, frame {}, segment {}, scale {}", to_string(event.state),
                       event.reason.empty() ? "" : ": ", event.reason, frames_, event.segment,
                       to_string(event.scale)))) {
    told_ns_ = now_ns;
  }
}

void ServiceNotifier::stopping() {
  if (fd_ >= 0) send(fmt::format("STOPPING=1\n{}\nSTATUS=saving", kLastWait));
}

void ServiceNotifier::finishing() {
  if (fd_ >= 0) send(fmt::format("{}\nSTATUS=finishing", kLastWait));
}

}  // namespace corvid
