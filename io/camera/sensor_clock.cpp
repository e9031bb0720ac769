#include "io/camera/sensor_clock.h"

#include "core/clock.h"
#include "core/log.h"

namespace corvid {
namespace {

constexpr double kOldest_s = 10;
// Stamps and arrivals may be taken on two processors.
constexpr double kAhead_s = 1e-3;

bool fits(std::int64_t stamp_ns, std::int64_t now_ns) {
  const double age_s = difference_s(now_ns, stamp_ns);
  return stamp_ns > 0 && age_s >= -kAhead_s && age_s <= kOldest_s;
}

}  // namespace

std::int64_t SensorClock::monotonic_ns(std::int64_t stamp_ns, std::int64_t arrival_ns,
                                       std::int64_t slept_ns) {
  const bool monotonic = fits(stamp_ns, arrival_ns);
  const bool boottime = fits(stamp_ns, arrival_ns + slept_ns);
  boottime_ = boottime && (boottime_ || !monotonic);
  by_arrival_ = !monotonic && !boottime;
  if (by_arrival_) {
    if (!said_) {
      log().warn(
          "{}: a picture's time stamp is of no known clock: such pictures get the time of "
          "their arrival",
          camera_);
    }
    said_ = true;
    return arrival_ns;
  }
  return boottime_ ? stamp_ns - slept_ns : stamp_ns;
}

}  // namespace corvid
