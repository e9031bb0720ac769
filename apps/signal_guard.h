#pragma once

#include <csignal>
#include <stop_token>
#include <thread>

namespace corvid {

/// While it lives, SIGINT and SIGTERM ask the run to stop instead of ending the process: the first
/// asks through token(), the second is answered that saving is under way, the third ends the
/// process at once with status 130. One at a time.
class SignalGuard {
 public:
  SignalGuard();
  ~SignalGuard();
  SignalGuard(const SignalGuard&) = delete;
  SignalGuard& operator=(const SignalGuard&) = delete;

  [[nodiscard]] std::stop_token token() const { return stop_.get_token(); }

 private:
  void listen();  // answers the bytes that the handler puts into the pipe

  std::stop_source stop_;
  int read_fd_ = -1, write_fd_ = -1;
  struct sigaction old_int_ {
  }, old_term_{}, old_pipe_{};
  std::thread listener_;
};

}  // namespace corvid
