#pragma once

#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "backend/map_data.h"
#include "backend/two_view.h"
#include "corvid/options.h"

namespace corvid {

/// A frame's pose, tied to a keyframe so that it follows that keyframe's corrections.
struct FrameRecord {
  FrameId frame;
  std::int64_t time_ns = 0;
  int keyframe = 0;  ///< position in the map
  Pose T_keyframe_frame;
  bool foretold = false;  ///< from the motion before: the frame showed nothing new
};

/// A new map segment with the frames that it covers.
struct StartedMap {
  MapData map;
  std::vector<FrameRecord> frames;  ///< ascending by time; the newest is a keyframe
};

/// Collects frames until two of its keyframes make a map (algorithms.md, 6: delayed start).
///
/// The newest keyframe is tried against each one held (at most 10); the accepted pair that is
/// explained best, with the most points and parallax, starts the map. All other frames held are
/// then resected, so that the trajectory covers them, and the whole is adjusted. A plane with two
/// explanations is settled by those other frames, or refused.
class Starter {
 public:
  void hold(const FrameTracks& tracks);
  void clear() { held_.clear(); }
  [[nodiscard]] bool newest_is_keyframe() const { return !held_.empty() && held_.back().keyframe; }
  [[nodiscard]] const std::string& reason() const { return reason_; }

  /// @param T_world_first  where the first keyframe of the pair shall be.
  /// @param median_depth   of the starting points seen from it, in the map's unit.
  [[nodiscard]] std::optional<StartedMap> attempt(const Camera& camera, int segment,
                                                  const Pose& T_world_first, double median_depth,
                                                  const BackendOptions& options, int threads);

 private:
  struct Held {
    FrameId id;
    std::int64_t time_ns = 0;
    bool keyframe = false;
    FramePtr frame;  // of keyframes only: images of the others may go
    std::vector<TrackObservation> observations;
  };
  struct Pair {
    std::size_t first = 0;
    TwoView two_view;
    std::vector<TrackId> tracks;
  };
  /// How badly the frames held agree with a motion hypothesis, means over the frames.
  struct Disagreement {
    double cost_px2 = 0;  ///< squared error, that of outliers at the limit
    double outliers = 0;  ///< share of the points
  };
  /// The map of one motion hypothesis.
  [[nodiscard]] std::optional<StartedMap> build(const Camera& camera, int segment,
                                                const Pose& T_world_first, double median_depth,
                                                const BackendOptions& options, int threads,
                                                const Pair& pair, const TwoViewMotion& motion,
                                                Disagreement* disagreement) const;
  [[nodiscard]] std::optional<Pair> best_pair(const Camera& camera, const BackendOptions& options);

  std::deque<Held> held_;
  std::string reason_ = "waiting for the first keyframes";
};

}  // namespace corvid
