#pragma once

#include <cstdint>
#include <optional>

#include "corvid/position.h"
#include "io/mavlink/messages.h"

namespace corvid {

/// The position in a receiver's report; nothing if it has none in three dimensions. Its standard
/// deviations are h_acc and v_acc; where they are not said 3 m times the dilution of precision;
/// where that is not said either PositionFix's default. The altitude is that above mean sea level:
/// the one above the ellipsoid is not always said.
[[nodiscard]] std::optional<PositionFix> position_fix(const mavlink::GpsRawInt& gps,
                                                      std::int64_t time_ns);

/// When the position was true, in our clock.
/// @param arrival_ns  of the message.
/// @param offset_ns   autopilot's clock minus ours, if known.
/// @param delay_ns    from the position to its message in the autopilot.
///
/// The message's own time counts where it is within the second before the arrival (it may be of the
/// Unix epoch, or missing); otherwise the arrival does.
[[nodiscard]] std::int64_t fix_time_ns(const mavlink::GpsRawInt& gps, std::int64_t arrival_ns,
                                       std::optional<std::int64_t> offset_ns,
                                       std::int64_t delay_ns);

}  // namespace corvid
