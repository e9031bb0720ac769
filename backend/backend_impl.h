#pragma once

#include <deque>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "backend/backend.h"
#include "backend/map_data.h"
#include "backend/map_positions.h"
#include "backend/places.h"
#include "backend/pose_doubt.h"
#include "backend/resect.h"
#include "backend/rest.h"
#include "backend/start.h"
#include "backend/window.h"
#include "core/stopwatch.h"

namespace corvid {

/// The backend's state and steps: backend.cpp has the way of a frame, backend_motion.cpp prediction
/// and what the frontend is told, backend_intrinsics.cpp when which intrinsics are refined,
/// backend_places.cpp what happens where the camera was before.
struct Backend::Impl {
  Impl(const BackendOptions& o, IntrinsicsOrigin intrinsics, int thread_count)
      : options(o), origin(intrinsics), threads(thread_count) {}

  /// Landmarks seen in a frame.
  struct Sighting {
    std::vector<PointView> points;
    std::vector<TrackId> tracks;
  };

  PoseEvent add(const FrameTracks& tracks);
  void add_blind(const FrameTracks& tracks, PoseEvent* event);
  void add_starting(const FrameTracks& tracks, PoseEvent* event);
  void add_tracking(const FrameTracks& tracks, PoseEvent* event);
  void add_stale(const FrameTracks& tracks, PoseEvent* event);
  void add_lost(const FrameTracks& tracks, std::string reason, PoseEvent* event);
  void place_event(PoseEvent* event) const;
  void judge(double visible, bool odd, PoseEvent* event) const;
  void learn_focal();
  void insert_keyframe(const FrameTracks& tracks, const std::vector<TrackId>& outliers,
                       const Resection& r);
  void rest_on_known_ground(int newest);
  [[nodiscard]] Drift drift_of(const Resection& r) const;
  [[nodiscard]] Sighting sight(const FrameTracks& tracks) const;
  /// A pose that no image has told.
  struct Foretold {
    Pose T_world_camera;
    /// Since the newest measured pose, if it went on as it was; nothing if only one is known.
    std::optional<Vector6d> motion;
  };
  [[nodiscard]] std::vector<const FrameRecord*> newest_measured(std::size_t count) const;
  [[nodiscard]] std::optional<Foretold> predict(std::int64_t time_ns) const;
  [[nodiscard]] bool jumps(const Resection& r, std::size_t points, std::int64_t time_ns) const;
  [[nodiscard]] Pose pose_of(const FrameRecord& record) const;
  [[nodiscard]] IntrinsicsPolicy intrinsics_policy() const;
  [[nodiscard]] IntrinsicsPolicy final_intrinsics_policy() const;
  [[nodiscard]] bool intrinsics_settle() const;
  [[nodiscard]] bool wide_enough(std::vector<double> ray_angles_rad) const;
  [[nodiscard]] int segment_keyframes() const {
    return static_cast<int>(map.keyframes.size()) - segment_first;
  }
  void straighten_segments();
  void adjust_newest();
  void enter_segment(int older);
  void choose_query(const FrameTracks& tracks, bool keyframe_of_map);
  void recognise(const PlaceMatch& match);
  [[nodiscard]] bool relocalize(const FrameTracks& tracks, const PlacePose& place);
  void publish_motion(std::span<const TrackObservation> observations);
  void publish_map();
  void lap(const char* part) { timings.emplace_back(part, watch.lap_ms()); }

  BackendOptions options;
  IntrinsicsOrigin origin;
  IntrinsicsFreedom freedom = IntrinsicsFreedom::fixed;  ///< of the first frame's camera
  int threads;

  enum class Mode { starting, tracking } mode = Mode::starting;
  MapData map;
  Camera prior;  ///< intrinsics as the source gave them
  bool have_camera = false;
  Starter starter;
  MapPositions positions{options};
  int segment = 0, segment_first = 0;
  int newest_segment = 0;  ///< highest number given so far
  std::vector<FrameRecord> frames;
  std::size_t segment_first_frame = 0;  ///< in `frames`
  FramePtr newest_frame;
  PoseDoubt doubt;
  int lost_frames = 0;
  FocalBelief focal{true};
  Camera focal_camera;      ///< with which `focal` was estimated
  double median_depth = 1;  ///< of the last good frame's landmarks
  std::uint64_t version = 0, resets = 0;
  FusedTracks fused;
  PlaceCounts places;
  std::optional<FrameTracks> query;
  std::deque<FrameTracks> waiting;  ///< queries that are not in the map, oldest first
  std::vector<TrackObservation> newest_observations;
  std::shared_ptr<const MapSnapshot> published_map = std::make_shared<MapSnapshot>();
  std::shared_ptr<const MotionState> published_motion = std::make_shared<MotionState>();
  Timings timings;
  Stopwatch watch;
};

}  // namespace corvid
