#include "corvid/map.h"

#include <algorithm>

namespace corvid {

std::string_view to_string(TrackingState state) {
  switch (state) {
    case TrackingState::starting:
      return "starting";
    case TrackingState::tracking:
      return "tracking";
    case TrackingState::degraded:
      return "degraded";
    case TrackingState::lost:
      return "lost";
  }
  return "unknown";
}

const Landmark* MapSnapshot::find(LandmarkId id) const {
  const auto it = std::lower_bound(landmarks.begin(), landmarks.end(), id,
                                   [](const Landmark& l, LandmarkId i) { return l.id < i; });
  return it != landmarks.end() && it->id == id ? &*it : nullptr;
}

}  // namespace corvid
