#pragma once

#include <spdlog/sinks/base_sink.h>

#include <mutex>
#include <ostream>
#include <string>

namespace corvid {

/// The one way to the terminal's error stream: log lines, and below them at most one progress line
/// that is redrawn in place. Thread-safe.
class Talk final : public spdlog::sinks::base_sink<std::mutex> {
 public:
  /// @param journal  lines begin with their priority, as systemd's journal reads it (sd-daemon(3)).
  explicit Talk(std::ostream& err, bool journal = false) : err_(err), journal_(journal) {}
  /// Replaces the progress line; an empty one removes it.
  void progress(const std::string& line);

 protected:
  void sink_it_(const spdlog::details::log_msg& message) override;
  void flush_() override;

 private:
  void erase_line();
  std::ostream& err_;
  const bool journal_;
  std::string line_;
};

/// Whether the standard error is connected to systemd's journal ($JOURNAL_STREAM names it).
[[nodiscard]] bool talks_to_journal();

}  // namespace corvid
