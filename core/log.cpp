#include "core/log.h"

#include <spdlog/sinks/null_sink.h>

namespace corvid {
namespace {
std::shared_ptr<spdlog::logger>& instance() {
  static std::shared_ptr<spdlog::logger> logger =
      std::make_shared<spdlog::logger>("corvid", std::make_shared<spdlog::sinks::null_sink_mt>());
  return logger;
}
}  // namespace

spdlog::logger& log() { return *instance(); }
void set_logger(std::shared_ptr<spdlog::logger> logger) { instance() = std::move(logger); }

}  // namespace corvid
