#include "bench/timing.h"

#include <sys/resource.h>

#include <algorithm>
#include <chrono>

namespace corvid {

double process_ms() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto ms = [](const timeval& t) {
    return 1e3 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_usec);
  };
  return ms(usage.ru_utime) + ms(usage.ru_stime);
}

double wall_ms() {
  const std::chrono::duration<double, std::milli> now =
      std::chrono::steady_clock::now().time_since_epoch();
  return now.count();
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  const std::size_t half = values.size() / 2;
  return values.size() % 2 == 1 ? values[half] : (values[half - 1] + values[half]) / 2;
}

std::vector<Timing> time_in_turn(std::span<const TimedWork> works, int runs,
                                 const std::stop_token& stop,
                                 const std::function<double()>& clock_ms) {
  struct Runs {
    std::vector<double> walls_ms;
    double cpu_ms = 0;
  };
  std::vector<Runs> measured(works.size());
  for (int run = -1; run < runs; ++run) {
    for (std::size_t i = 0; i < works.size(); ++i) {
      if (stop.stop_requested()) return {};
      if (works[i].before) works[i].before();
      const double cpu = process_ms();
      const double start = clock_ms();
      works[i].run();
      const double wall = clock_ms() - start;
      if (run < 0) continue;
      measured[i].walls_ms.push_back(wall);
      measured[i].cpu_ms += process_ms() - cpu;
    }
  }
  std::vector<Timing> timings;
  for (const Runs& m : measured) {
    timings.push_back({median(m.walls_ms), *std::min_element(m.walls_ms.begin(), m.walls_ms.end()),
                       m.cpu_ms / static_cast<double>(runs)});
  }
  return timings;
}

}  // namespace corvid
