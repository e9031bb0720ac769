#include "apps/talk.h"

#include <string_view>

namespace corvid {

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
  if (message.level >= spdlog::level::warn || message.level <= spdlog::level::debug) {
    const auto level = spdlog::level::to_string_view(message.level);
    err_ << std::string_view(level.data(), level.size()) << ": ";
  }
  err_ << std::string_view(message.payload.data(), message.payload.size()) << '\n' << line_;
  err_.flush();
}

void Talk::flush_() { err_.flush(); }

}  // namespace corvid
