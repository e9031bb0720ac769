#pragma once

#include <string_view>

namespace corvid {

/// Throws std::logic_error "file:line: condition: message". For bugs, never for the world's faults.
[[noreturn]] void check_failed(const char* file, int line, const char* condition,
                               std::string_view message);

}  // namespace corvid

#define CORVID_CHECK(condition, message)                                               \
  do {                                                                                 \
    if (!(condition)) ::corvid::check_failed(__FILE__, __LINE__, #condition, message); \
  } while (false)
