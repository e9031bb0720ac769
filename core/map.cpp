#include "corvid/map.h"

#include <algorithm>
#include <utility>

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

Landmarks::Landmarks(std::vector<Landmark> landmarks) : size_(landmarks.size()) {
  if (size_ > 0)
    chunks_.push_back(std::make_shared<const std::vector<Landmark>>(std::move(landmarks)));
}

Landmarks::Landmarks(std::vector<Chunk> chunks) : chunks_(std::move(chunks)) {
  for (const Chunk& chunk : chunks_) size_ += chunk->size();
}

const Landmark* Landmarks::find(LandmarkId id) const {
  const auto chunk =
      std::lower_bound(chunks_.begin(), chunks_.end(), id,
                       [](const Chunk& c, LandmarkId i) { return c->back().id < i; });
  if (chunk == chunks_.end()) return nullptr;
  const auto it = std::lower_bound((*chunk)->begin(), (*chunk)->end(), id,
                                   [](const Landmark& l, LandmarkId i) { return l.id < i; });
  return it->id == id ? &*it : nullptr;
}

}  // namespace corvid
