#pragma once

#include <spdlog/logger.h>

#include <memory>

namespace corvid {

/// The library's logger, named "corvid". Silent (no sink) until a program adds one:
/// the library itself never prints.
[[nodiscard]] spdlog::logger& log();
/// Replaces the logger; the program calls it once at its start, before any thread.
void set_logger(std::shared_ptr<spdlog::logger> logger);

}  // namespace corvid
