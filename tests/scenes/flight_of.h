#pragma once

#include "replay/synthetic_flight.h"

namespace corvid::scenes {

/// Options of a synthetic flight of this size; everything else is the default.
inline FlightOptions flight_of(int width_px, int height_px, double duration_s) {
  FlightOptions options;
  options.width_px = width_px;
  options.height_px = height_px;
  options.duration_s = duration_s;
  return options;
}

}  // namespace corvid::scenes
