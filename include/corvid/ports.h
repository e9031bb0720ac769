#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "corvid/error.h"
#include "corvid/frame.h"
#include "corvid/map.h"
#include "corvid/mesh_stream.h"
#include "corvid/pose.h"
#include "corvid/position.h"

namespace corvid {

/// Where the camera's intrinsics come from, best first.
enum class IntrinsicsOrigin {
  calibration,
  exif,
  nominal,  ///< the maker's or the data set's figures for this kind of camera
  guess
};

/// What a source says of itself before the first frame.
struct SourceInfo {
  std::string kind;  ///< "EuRoC/ASL", "KITTI odometry", "image folder", ...
  std::string path;
  std::optional<std::size_t> frames;  ///< if known
  double rate_hz = 0;                 ///< nominal; 0 if unknown
  bool stills = false;                ///< photographs far apart, not a video stream
  bool paced = false;                 ///< frames come at their own pace: a late engine drops them
  bool colour = false;
  std::shared_ptr<const Camera> camera;
  IntrinsicsOrigin intrinsics = IntrinsicsOrigin::calibration;
  bool has_depth = false;          ///< depth images lie beside the frames
  std::vector<std::string> notes;  ///< anything the user should know, one sentence each
};

/// Frames that did not come through, with the reasons.
struct SourceCounts {
  std::uint64_t delivered = 0;
  std::uint64_t skipped = 0;  ///< could not be read: missing, corrupt, changed size, time went back
  std::uint64_t dropped = 0;  ///< came too late for the consumer (paced replay, live)
  std::vector<std::string> messages;  ///< one per skip, at most 100
  std::uint64_t lost = 0;             ///< counted by the camera, but never came to this program
  std::uint64_t interruptions = 0;    ///< times that the camera was away or stood still
};

/// Port: frames come in. One owner at a time; not thread-safe.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  [[nodiscard]] virtual const SourceInfo& info() const = 0;
  /// The next frame; nullptr at the end of the source. Frames that cannot be read are skipped and
  /// counted; an error means that nothing more will come. While a live camera gives no pictures,
  /// blind frames come instead, about one a second (Frame::blind); they are not counted.
  [[nodiscard]] virtual Expected<FramePtr> next(const std::stop_token& stop = {}) = 0;
  [[nodiscard]] virtual SourceCounts counts() const = 0;
  /// True camera poses, if the source has them; empty otherwise. Times match the frames' or
  /// enclose them (a source may give truth at its own rate).
  [[nodiscard]] virtual Trajectory truth() const { return {}; }
  /// Positions that came with the frames (EXIF), at the frames' times; empty if there are none.
  [[nodiscard]] virtual std::vector<PositionFix> positions() const { return {}; }
  /// The true surface, if the source knows it (the synthetic flight).
  [[nodiscard]] virtual std::optional<TriangleMesh> true_surface() const { return std::nullopt; }
};

/// Port: one event per frame goes out. Called on the backend's thread; must return quickly.
class PoseSink {
 public:
  virtual ~PoseSink() = default;
  virtual void on_pose(const PoseEvent& event) = 0;
};

/// Port: the map goes out whenever it has changed. Called on the backend's thread; must return
/// quickly.
class MapSink {
 public:
  virtual ~MapSink() = default;
  virtual void on_map(const std::shared_ptr<const MapSnapshot>& map) = 0;
};

/// Port: changed mesh blocks go out. Called on the mapping thread.
class MeshSink {
 public:
  virtual ~MeshSink() = default;
  virtual void on_block(const MeshBlock& block) = 0;
  /// Every block of that version was given: together the newest ones are the surface of one moment.
  /// A surface that is made anew with other voxels is complete when all keyframes are back in it.
  virtual void on_complete(std::uint64_t /*version*/) {}
};

}  // namespace corvid
