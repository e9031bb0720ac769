#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "corvid/frame.h"
#include "corvid/ids.h"
#include "corvid/pose.h"
#include "corvid/position.h"

namespace corvid {

enum class TrackingState { starting, tracking, degraded, lost };
[[nodiscard]] std::string_view to_string(TrackingState state);

/// What the engine says about one frame.
struct PoseEvent {
  FrameId frame;
  std::int64_t time_ns = 0;
  TrackingState state = TrackingState::starting;
  std::string reason;                  ///< why, if the state is not `tracking`
  std::optional<Pose> T_world_camera;  ///< absent while starting or lost
  /// Of the pose's right perturbation (rho, phi) [map units, rad], relative to the segment's start
  /// and in its scale, drift of both included; zero if there is no pose.
  Matrix6d covariance = Matrix6d::Zero();
  int tracks = 0;      ///< image tracks in this frame
  int inliers = 0;     ///< landmarks that agree with the pose
  double mse_px2 = 0;  ///< mean squared reprojection error of the inliers, thesis (3.15)
  bool keyframe = false;
  int segment = 0;  ///< map segment; rises when a lost camera starts a new map
  /// Metric once positions have fixed the similarity to the Earth; see `placement`.
  MapScale scale = MapScale::arbitrary;
  /// Where the segment lies on Earth, or why that is not known; null if no position ever came.
  std::shared_ptr<const MapPlacement> placement;
  /// Rises when poses jump against those given before: a new segment, a relocalization, a closed
  /// loop, a merge of segments. Positions of different counts must not be compared.
  std::uint64_t resets = 0;
  double latency_ms =
      0;  ///< from the frame's entry into the engine to this event; 0 if it is blind
};

/// What recognised places did to a map.
struct PlaceCounts {
  int relocalizations = 0, loops = 0, merges = 0;  ///< a merge makes one segment of two
  int connections = 0;                             ///< places recognised where the map fitted
  int refused = 0;                                 ///< looked alike, but were not believed
};

struct Landmark {
  LandmarkId id;
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  Rgb8 colour;
  int observations = 0;          ///< keyframes that see it
  double max_ray_angle_rad = 0;  ///< widest angle between two viewing rays
};

struct Observation {
  LandmarkId landmark;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
};

struct Keyframe {
  KeyframeId id;
  int segment = 0;
  StoredFramePtr frame;
  Pose T_world_camera;
  std::vector<Observation> observations;  ///< of landmarks only, sorted by landmark
};

/// Landmarks by id, in chunks that consecutive snapshots share where nothing changed: the price of
/// a snapshot does not grow with the map.
class Landmarks {
 public:
  using Chunk = std::shared_ptr<const std::vector<Landmark>>;
  class Iterator {
   public:
    using iterator_category = std::forward_iterator_tag;
    using value_type = Landmark;
    using difference_type = std::ptrdiff_t;
    using pointer = const Landmark*;
    using reference = const Landmark&;
    Iterator() = default;
    [[nodiscard]] reference operator*() const { return (**chunk_)[at_]; }
    [[nodiscard]] pointer operator->() const { return &**this; }
    Iterator& operator++() {
      if (++at_ == (*chunk_)->size()) {
        ++chunk_;
        at_ = 0;
      }
      return *this;
    }
    Iterator operator++(int) {
      Iterator before = *this;
      ++*this;
      return before;
    }
    bool operator==(const Iterator&) const = default;

   private:
    friend class Landmarks;
    explicit Iterator(std::vector<Chunk>::const_iterator chunk) : chunk_(chunk) {}
    std::vector<Chunk>::const_iterator chunk_;
    std::size_t at_ = 0;
  };

  Landmarks() = default;
  /// @param landmarks  by id.
  explicit Landmarks(std::vector<Landmark> landmarks);
  /// @param chunks  ascending, by id, none of them null or empty.
  explicit Landmarks(std::vector<Chunk> chunks);

  [[nodiscard]] Iterator begin() const { return Iterator(chunks_.begin()); }
  [[nodiscard]] Iterator end() const { return Iterator(chunks_.end()); }
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] bool empty() const { return size_ == 0; }
  /// nullptr if there is none of that id.
  [[nodiscard]] const Landmark* find(LandmarkId id) const;

 private:
  std::vector<Chunk> chunks_;
  std::size_t size_ = 0;
};

/// The sparse map at one moment. Immutable.
struct MapSnapshot {
  std::uint64_t version = 0;
  std::shared_ptr<const Camera> camera;  ///< with refined intrinsics where they were unknown
  std::vector<std::shared_ptr<const Keyframe>> keyframes;  ///< by id
  Landmarks landmarks;
  [[nodiscard]] const Landmark* find(LandmarkId id) const { return landmarks.find(id); }
};

/// Depth of one keyframe, on an undistorted pinhole camera.
struct DepthMap {
  KeyframeId keyframe;
  Camera camera;
  Pose T_world_camera;    ///< at the time of the estimate; of the final map in a RunResult
  FloatImage depth;       ///< z in camera coordinates [map units]; 0 = no answer
  FloatImage confidence;  ///< fused correlation score in [0, 1]; 0 = no answer
};

}  // namespace corvid
