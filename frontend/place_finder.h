#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/place.h"
#include "core/stopwatch.h"
#include "core/tracks.h"
#include "corvid/error.h"
#include "corvid/map.h"
#include "corvid/options.h"
#include "frontend/pair_matcher.h"
#include "frontend/place_index.h"
#include "kernels/device.h"

namespace corvid {

/// What looking for a frame's place gave.
struct PlaceSearch {
  PlaceMatch match;
  std::vector<std::string> refusals;  ///< of keyframes that looked alike, one each
};

/// Finds the keyframes of the map that show what a frame shows, without knowing where it is:
/// similar images are ranked by PlaceIndex, and the best are matched with the frame by PairMatcher,
/// which gives the exact place of the old keyframe's landmarks in it.
///
/// Keyframes of one map are indexed as they come; memory is 3 KiB for each. One owner; not
/// thread-safe. Deterministic. find() throws DeviceFault.
class PlaceFinder {
 public:
  /// Its launches are put into Lane::mapping: it is work of the background.
  /// @param yield  called between slices of some 10 ms, so that urgent work can go before; may be
  ///               empty.
  [[nodiscard]] static Expected<std::unique_ptr<PlaceFinder>> create(
      std::shared_ptr<Device> device, const PlaceOptions& options, const MatchingOptions& matching,
      std::function<void()> yield = {});

  /// Keyframes whose match was in vain let up to seven that follow rest, those that were found
  /// three: who knows where the camera is can wait. A frame that is no keyframe of the map is
  /// looked for at once.
  /// @param query  a frame; what its tracks are connected with is no news and is left out.
  /// @param map    a state of the same growing map as in the calls before.
  [[nodiscard]] PlaceSearch find(const FrameTracks& query, const MapSnapshot& map);
  /// Wall time of the parts of the last find() [ms].
  [[nodiscard]] const Timings& last_timings_ms() const { return timings_; }

 private:
  PlaceFinder(const PlaceOptions& options, std::unique_ptr<PairMatcher> pairs,
              std::function<void()> yield);
  /// Keyframes with landmarks, none of which the query's tracks know, by position.
  [[nodiscard]] static std::vector<std::uint8_t> unconnected(const FrameTracks& query,
                                                             const MapSnapshot& map);
  /// The landmarks of a keyframe in the query; without any, `refusal` says why.
  [[nodiscard]] PlaceReference verify(const Keyframe& keyframe, const MatchView& target,
                                      std::string& refusal);

  PlaceOptions options_;
  std::unique_ptr<PairMatcher> pairs_;
  std::function<void()> yield_;
  PlaceIndex index_;
  int vain_ = 0, resting_ = 0;
  Timings timings_;
};

}  // namespace corvid
