#pragma once

#include <string>
#include <utility>
#include <vector>

namespace corvid {

/// Keeps a message beside a count of what went wrong; only the first hundred are kept.
inline void add_message(std::vector<std::string>& messages, std::string message) {
  constexpr std::size_t kMost = 100;
  if (messages.size() < kMost) messages.push_back(std::move(message));
}

}  // namespace corvid
