#include "core/clock.h"

#include <condition_variable>
#include <mutex>

namespace corvid {

std::int64_t SteadyClock::now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

void SteadyClock::sleep_until(std::int64_t time_ns, const std::stop_token& stop) {
  std::mutex mutex;
  std::condition_variable_any wake;
  std::unique_lock lock(mutex);
  const std::chrono::steady_clock::time_point deadline{std::chrono::nanoseconds(time_ns)};
  wake.wait_until(lock, stop, deadline, [] { return false; });
}

}  // namespace corvid
