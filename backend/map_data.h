#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <vector>

#include "backend/drift.h"
#include "backend/triangulate.h"
#include "core/tracks.h"
#include "corvid/map.h"

namespace corvid {

/// A track in one keyframe.
struct KeyframeView {
  int keyframe = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Vector3d ray_camera = Eigen::Vector3d::UnitZ();
  double sigma_px = 1;
};

/// What is known about one track: its views in keyframes, and its point once it has one.
struct MapTrack {
  std::vector<KeyframeView> views;  ///< ascending by keyframe
  bool landmark = false;            ///< p_world is known
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  Rgb8 colour;
  double max_ray_angle_rad = 0;
  int strikes = 0;    ///< frames in a row in which it disagreed with the pose
  int failures = 0;   ///< triangulations that did not fit
  bool dead = false;  ///< the frontend follows the wrong thing: later observations do not count
};

/// A measured camera centre: sqrt_information * (t - p_world) has unit covariance.
struct PositionPrior {
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  Eigen::Matrix3d sqrt_information = Eigen::Matrix3d::Zero();
};

/// The keyframe that another one, which rests, moves with.
struct RestingPlace {
  int keyframe = 0;
  Pose T_host_this;
};

struct MapKeyframe {
  StoredFramePtr frame;
  int segment = 0;
  Pose T_world_camera;
  Drift drift;  ///< since the segment's start; not known of keyframes before the first window
  FocalEstimate focal;                        ///< what the window says that ended here
  std::vector<TrackId> tracks;                ///< ascending; those with a view here or once had
  std::optional<PositionPrior> position;      ///< set by MapPositions
  bool tied = false;                          ///< to a part of the map that is much older: tie()
  std::optional<RestingPlace> host;           ///< set where it rests: it sees nothing any more
  std::shared_ptr<const Keyframe> published;  ///< null if it sees something else since
  /// Landmarks that got another id since: first -> second, in this order.
  std::vector<std::pair<TrackId, TrackId>> renamed;
};

/// The map that the backend works on: keyframes and tracks, by position and by id.
struct MapData {
  Camera camera;
  std::vector<MapKeyframe> keyframes;
  std::map<TrackId, MapTrack> tracks;
  /// Of the last snapshot, by chunk_of() their id. What a keyframe sees that is to be published
  /// anew is made anew, and what is named here.
  std::map<std::uint32_t, Landmarks::Chunk> published_landmarks;
  std::set<std::uint32_t> stale_landmarks;

  /// Appends a keyframe; usable observations become views of their tracks. Returns its position.
  int add_keyframe(const FramePtr& frame, int segment, const Pose& T_world_camera,
                   const std::vector<TrackObservation>& observations);
  /// Gives a track its point (and its colour, from the newest keyframe that sees it).
  void make_landmark(MapTrack& track, const Triangulation& point);
  /// Takes the point away again.
  void drop_landmark(MapTrack& track);
  /// Removes the view at position `view` of a track.
  void drop_view(MapTrack& track, std::size_t view);
  /// Makes a point of every living track without one that is seen in keyframe k and one before,
  /// where the rays allow it. Returns how many.
  int triangulate_tracks(int keyframe, double min_angle_rad, double max_error_px);
  /// Forgets tracks without a point that end before or in keyframe k.
  void forget_tracks(int keyframe);
  /// Views as rays in the world.
  [[nodiscard]] std::vector<RayView> ray_views(const MapTrack& track) const;
  /// Replaces the intrinsics; rays of the views are computed anew.
  void set_camera(const Camera& refined);
  /// Takes a track out of the map; no keyframe may name it any more.
  void erase_track(TrackId id);
  /// An immutable copy; what did not change is shared with the last copy. A landmark has changed if
  /// a keyframe that names it has (`published` is null), if it was erased, or if its chunk is named
  /// stale.
  [[nodiscard]] std::shared_ptr<const MapSnapshot> snapshot(std::uint64_t version);
  /// Appends another map, whose tracks replace those of the same id here.
  void append(MapData&& other);
};

/// Which chunk of a snapshot's landmarks holds an id.
[[nodiscard]] std::uint32_t chunk_of(TrackId id);

/// largest_sigma_px() of an observation: never below what NCC peaks can deliver.
[[nodiscard]] double floored_sigma_px(const TrackObservation& observation);

/// Finite, and inside what the camera model can invert.
[[nodiscard]] std::optional<Eigen::Vector3d> usable_ray(const Camera& camera,
                                                        const TrackObservation& observation);

}  // namespace corvid
