#include "apps/talk.h"

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <string_view>

namespace corvid {
namespace {

/// syslog's priorities.
std::string_view priority(spdlog::level::level_enum level) {
  switch (level) {
    case spdlog::level::critical:
    case spdlog::level::err:
      return "<3>";
    case spdlog::level::warn:
      return "<4>";
    case spdlog::level::info:
      return "<6>";
    default:
      return "<7>";
  }
}

}  // namespace

void Talk::erase_line() {
  if (!line_.empty()) err_ << "\r\x1b[K";
}

void Talk::progress(const std::string& line) {
  const std::scoped_lock lock(mutex_);
  erase_line();
  line_ = line;
  err_ << line_ << std::flush;
}

void Talk::sink_it_(const spdlog::details::log_msg& message) {
  erase_line();
  if (journal_) err_ << priority(message.level);
  if (message.level >= spdlog::level::warn || message.level <= spdlog::level::debug) {
    const auto level = spdlog::level::to_string_view(message.level);
    err_ << std::string_view(level.data(), level.size()) << ": ";
  }
  err_ << std::string_view(message.payload.data(), message.payload.size()) << '\n' << line_;
  err_.flush();
}

void Talk::flush_() { err_.flush(); }

bool talks_to_journal() {
  const char* const named = std::getenv("JOURNAL_STREAM");
  struct stat file {};
  return named != nullptr && fstat(STDERR_FILENO, &file) == 0 &&
         fmt::format("{}:{}", file.st_dev, file.st_ino) == named;
}

}  // namespace corvid
