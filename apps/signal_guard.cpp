#include "apps/signal_guard.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>

#include "apps/program.h"
#include "core/check.h"
#include "core/log.h"

namespace corvid {
namespace {

// What the handler may touch: lock-free atomics and write().
std::atomic<int> pipe_fd{-1};
std::atomic<int> signals_seen{0};
static_assert(std::atomic<int>::is_always_lock_free);
constexpr char kSignal = 's', kEnd = 'e';

void handle(int) {
  const int saved_errno = errno;
  if (signals_seen.fetch_add(1) >= 2) _exit(static_cast<int>(ExitCode::interrupted));
  [[maybe_unused]] const auto written = write(pipe_fd.load(), &kSignal, 1);
  errno = saved_errno;
}

}  // namespace

SignalGuard::SignalGuard() {
  CORVID_CHECK(pipe_fd.load() == -1, "only one SignalGuard at a time");
  int fds[2] = {-1, -1};
  CORVID_CHECK(pipe2(fds, O_CLOEXEC) == 0, "no pipe for signals: too many open files");
  read_fd_ = fds[0];
  write_fd_ = fds[1];
  signals_seen = 0;
  pipe_fd = write_fd_;
  listener_ = std::thread([this] { listen(); });
  struct sigaction action {};
  action.sa_handler = handle;
  action.sa_flags = SA_RESTART;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, &old_int_);
  sigaction(SIGTERM, &action, &old_term_);
  action.sa_handler = SIG_IGN;
  sigaction(SIGPIPE, &action, &old_pipe_);
}

SignalGuard::~SignalGuard() {
  sigaction(SIGINT, &old_int_, nullptr);
  sigaction(SIGTERM, &old_term_, nullptr);
  sigaction(SIGPIPE, &old_pipe_, nullptr);
  [[maybe_unused]] const auto written = write(write_fd_, &kEnd, 1);
  listener_.join();
  pipe_fd = -1;
  close(read_fd_);
  close(write_fd_);
}

void SignalGuard::listen() {
  int count = 0;
  char byte = 0;
  while (true) {
    const auto got = read(read_fd_, &byte, 1);
    if (got < 0 && errno == EINTR) continue;
    if (got != 1 || byte == kEnd) return;
    if (++count == 1) {
      log().warn("stopping: what there is will be saved");
      stop_.request_stop();
    } else {
      log().warn("saving is under way; once more ends at once and loses it");
    }
  }
}

}  // namespace corvid
