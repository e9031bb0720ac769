#pragma once

#include <cstddef>
#include <memory>

#include "corvid/archive.h"
#include "corvid/map.h"

namespace corvid {

/// How much of a depth map is answered.
struct DepthAnswers {
  std::size_t pixels = 0, answered = 0;
  double confidence = 0;  ///< sum over the answers
};

/// A keyframe's depth map, which need not stay in memory: put away in an archive it comes back for
/// as long as somebody holds it. Copies share the answers, and have a place and a scale each.
/// Thread-safe as far as its copies go.
class StoredDepth {
 public:
  explicit StoredDepth(DepthMap map);

  KeyframeId keyframe;
  Pose T_world_camera;  ///< where the camera is by now
  double scale = 1;     ///< by which lengths have grown since the estimate

  /// The depth map at T_world_camera, its depths multiplied by `scale`. If it cannot be read back:
  /// without answers (its images are empty), and a warning is logged.
  [[nodiscard]] DepthMap load() const;
  /// The depths multiplied by `scale`, but at the pose of the estimate; no copy where scale is 1.
  /// Never null.
  [[nodiscard]] std::shared_ptr<const DepthMap> scaled() const;
  /// Lets go of the images, which stay in the archive; does nothing if they are there already.
  /// Errors: io; then they stay in memory.
  [[nodiscard]] Expected<void> put_away(const std::shared_ptr<Archive>& archive) const;
  [[nodiscard]] std::size_t image_bytes() const;
  /// Known without reading anything back.
  [[nodiscard]] const DepthAnswers& answers() const;
  [[nodiscard]] bool in_memory() const;

 private:
  struct Shared;
  std::shared_ptr<Shared> shared_;
};

}  // namespace corvid
