#include "io/mavlink/gps_fix.h"

#include <cmath>

namespace corvid {
namespace {

constexpr std::uint8_t kFix3d = 3;
constexpr double kRange_m = 3;  // of one satellite's range, as the receivers of autopilots have it

/// Standard deviation [m]; nothing if neither is said.
std::optional<double> sigma_m(std::uint32_t accuracy_mm, std::uint16_t dilution_x100) {
  if (accuracy_mm != 0) return 1e-3 * accuracy_mm;
  if (dilution_x100 != 0 && dilution_x100 != mavlink::GpsRawInt::kUnknown) {
    return kRange_m * 0.01 * dilution_x100;
  }
  return std::nullopt;
}

}  // namespace

std::optional<PositionFix> position_fix(const mavlink::GpsRawInt& gps, std::int64_t time_ns) {
  if (gps.fix_type < kFix3d) return std::nullopt;
  PositionFix fix;
  fix.time_ns = time_ns;
  fix.position = {1e-7 * gps.lat, 1e-7 * gps.lon, 1e-3 * gps.alt};
  if (const auto sigma = sigma_m(gps.h_acc, gps.eph)) {
    fix.covariance_m2(0, 0) = fix.covariance_m2(1, 1) = *sigma * *sigma;
  }
  if (const auto sigma = sigma_m(gps.v_acc, gps.epv)) fix.covariance_m2(2, 2) = *sigma * *sigma;
  return fix;
}

std::int64_t fix_time_ns(const mavlink::GpsRawInt& gps, std::int64_t arrival_ns,
                         std::optional<std::int64_t> offset_ns, std::int64_t delay_ns) {
  if (offset_ns) {
    // In double: whatever the message says, nothing overflows, and 1e-6 s is good enough.
    const double age_s =
        1e-9 * (static_cast<double>(arrival_ns) + static_cast<double>(*offset_ns)) -
        1e-6 * static_cast<double>(gps.time_usec);
    constexpr double kRounding_s = 0.02, kMostAge_s = 1;
    if (age_s > -kRounding_s && age_s < kMostAge_s) {
      return arrival_ns - static_cast<std::int64_t>(1e9 * age_s) - delay_ns;
    }
  }
  return arrival_ns - delay_ns;
}

}  // namespace corvid
