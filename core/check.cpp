#include "core/check.h"

#include <fmt/format.h>

#include <stdexcept>

namespace corvid {

void check_failed(const char* file, int line, const char* condition, std::string_view message) {
  throw std::logic_error(fmt::format("{}:{}: {}: {}", file, line, condition, message));
}

}  // namespace corvid
