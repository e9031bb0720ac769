#pragma once

#include <functional>
#include <span>
#include <stop_token>
#include <vector>

namespace corvid {

/// What the runs of one piece of work took.
struct Timing {
  double median_ms = 0, fastest_ms = 0;
  double cpu_ms = 0;  ///< mean processor time of the process, the OpenCL device's threads included
};

/// A piece of work to be timed.
struct TimedWork {
  std::function<void()> run;
  std::function<void()> before{};  ///< before each run, not timed; may be empty
};

/// Milliseconds of the steady clock.
[[nodiscard]] double wall_ms();
/// Processor time of this process so far, all threads [ms].
[[nodiscard]] double process_ms();

/// Runs each once for the caches, clocks and buffers, then all in turn (first, second, ..., first,
/// second, ...) `runs` times, so that all see the same load of the machine. One Timing per work;
/// empty if `stop` was requested before the last run. What the work throws comes out.
/// @param clock_ms  wall time [ms] since any moment; read just before and just after each run.
[[nodiscard]] std::vector<Timing> time_in_turn(std::span<const TimedWork> works, int runs,
                                               const std::stop_token& stop,
                                               const std::function<double()>& clock_ms = wall_ms);

/// The middle value, or the mean of the two middle values; 0 if there is none.
[[nodiscard]] double median(std::vector<double> values);

}  // namespace corvid
