#pragma once

#include <cstddef>
#include <vector>

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

/// A flight with all its frames, for tests that share them.
struct RenderedFlight {
  SyntheticFlight flight;
  std::vector<FramePtr> frames;
  explicit RenderedFlight(const FlightOptions& options) : flight(options) {
    for (std::size_t i = 0; i < flight.frame_count(); ++i) frames.push_back(flight.render(i));
  }
};

}  // namespace corvid::scenes
