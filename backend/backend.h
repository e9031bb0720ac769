#pragma once

#include <memory>
#include <optional>
#include <span>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "core/place.h"
#include "core/tracks.h"
#include "corvid/map.h"
#include "corvid/options.h"
#include "corvid/ports.h"
#include "corvid/pose.h"

namespace corvid {

/// Poses and landmarks from tracks, frame by frame: two-view start, resection, triangulation,
/// windowed bundle adjustment (algorithms.md, 6).
///
/// World frame: the camera frame of the keyframe that a map segment starts from; unit of length:
/// the median depth of the starting landmarks seen from it. Scale is arbitrary.
///
/// Synchronous, one owner, not thread-safe; what it returns by shared_ptr is immutable and may
/// cross threads. Results repeat bit for bit if threads == 1.
class Backend {
 public:
  /// @param origin  where the cameras' intrinsics come from: with options.intrinsics it decides
  ///        which of them are estimated, too (backend/intrinsics.h).
  /// @param threads  of the window adjustment; 0: as many as the machine has cores.
  Backend(const BackendOptions& options, IntrinsicsOrigin origin, int threads);
  ~Backend();
  Backend(const Backend&) = delete;
  Backend& operator=(const Backend&) = delete;

  /// One frame in, one event out. Frames come in order of time; tracks.observations are sorted by
  /// track; the keyframe flag is the frontend's. The image may be empty: only colours come from it.
  /// After a keyframe map() and motion() are new; after any other frame motion() is.
  PoseEvent add(const FrameTracks& tracks);
  /// Positions of the camera, in any order; they count from the next keyframe on.
  void add_positions(std::span<const PositionFix> fixes);
  /// The last added frame, if it is worth looking for among older keyframes: a keyframe of the map,
  /// or one of the frames while the camera is lost or a new segment starts.
  [[nodiscard]] const std::optional<FrameTracks>& place_query() const;
  /// A frame that place_query() gave was recognised in a state of map() since then. Between two
  /// frames: finds a lost camera again, closes a loop, or joins two segments; or does nothing, if
  /// it is not believed or comes too late. Afterwards map() and motion() are new.
  void recognise(const PlaceMatch& match);
  [[nodiscard]] const PlaceCounts& places() const;
  /// For the frontend's prediction of the next frame. Never null.
  [[nodiscard]] std::shared_ptr<const MotionState> motion() const;
  /// The newest published map. Never null; without keyframes while starting.
  [[nodiscard]] std::shared_ptr<const MapSnapshot> map() const;
  /// Adjusts the whole map once more (if options.final_adjustment) and publishes it. Asked to stop,
  /// it ends within an iteration and keeps what was reached.
  /// @return whether the adjustment was left to end by itself.
  bool finish(const std::stop_token& stop = {});
  /// Every frame that has a pose, with all corrections that its reference keyframe got since.
  /// Frames between the two starting keyframes are in it, although their events had no pose.
  [[nodiscard]] Trajectory trajectory() const;
  /// The map segment of each of its poses.
  [[nodiscard]] std::vector<int> trajectory_segments() const;
  /// Where each segment lies on Earth, newest knowledge; nothing is metric without positions.
  [[nodiscard]] std::vector<MapPlacement> placements() const;
  /// Wall time of the parts of the last add() that ran: "backend/start", "backend/resect",
  /// "backend/triangulate", "backend/positions" (if there are any), "backend/adjust"; of the last
  /// recognise(): "backend/place" [ms].
  [[nodiscard]] std::vector<std::pair<std::string, double>> last_timings_ms() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace corvid
