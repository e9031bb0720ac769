#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "corvid/camera.h"
#include "corvid/ports.h"

namespace corvid {

/// What the camera does over the procedural town. All paths are smooth and of any length.
enum class FlightPath {
  survey,    ///< forward over the roofs at about 30 m, looking 45 degrees down, gentle turns
  orbit,     ///< around the town, looking at its middle
  nadir,     ///< as survey, looking straight down
  loop,      ///< a closed round in duration_s: the last frame's pose equals the first's exactly
  facade,    ///< along a street of identical windows, looking at them from the side
  hover,     ///< one constant pose
  rotation,  ///< turns about the camera's centre, without any translation
};

struct FlightOptions {
  int width_px = 752, height_px = 480;
  double rate_hz = 20, duration_s = 20;
  std::uint64_t seed = 1;  ///< of the town, the path and the sensor noise
  FlightPath path = FlightPath::survey;
  double speed_mps = 0;                      ///< 0: the path's own, 7 m/s for a survey
  CameraModel model = CameraModel::pinhole;  ///< the others with a typical distortion
  double horizontal_fov_rad = 1.4;
  bool colour = true;
  double noise_sigma = 1.2;        ///< standard deviation of the sensor noise [grey levels]
  double optical_blur_px = 0.55;   ///< sigma of the lens [px]; 0: none
  double shutter_s = 0;            ///< open time for motion blur; 0: none. Costs 4 renderings
  double vignetting = 0.3;         ///< share of the light lost in the image's corners
  double exposure_change = 0.15;   ///< amplitude of the slow changes of the gain; 0: constant
  std::int64_t start_time_ns = 0;  ///< capture time of the first frame
  int threads = 0;                 ///< that render; 0: one per core. Never changes a result
  [[nodiscard]] std::vector<std::string> validate() const;
};

/// A drone's flight over a procedural town, rendered frame by frame with its exact truth.
///
/// World: metres, z up, origin in the middle of the town at mean ground level. The same options
/// give the same bytes whatever the number of threads. A frame is rendered when it is asked for.
class SyntheticFlight final : public FrameSource {
 public:
  /// Fails with the list of wrong options.
  [[nodiscard]] static Expected<std::unique_ptr<SyntheticFlight>> open(
      const FlightOptions& options);
  /// @pre options.validate() is empty.
  explicit SyntheticFlight(const FlightOptions& options = {});
  ~SyntheticFlight() override;

  [[nodiscard]] const SourceInfo& info() const override;
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop = {}) override;
  [[nodiscard]] SourceCounts counts() const override;
  /// One exact pose per frame [m], at the frames' times.
  [[nodiscard]] Trajectory truth() const override;
  /// The surface that is rendered, exactly: terrain and every solid, without the faces that
  /// nothing can see (buried or covered ones).
  [[nodiscard]] std::optional<TriangleMesh> true_surface() const override;

  [[nodiscard]] std::size_t frame_count() const;
  [[nodiscard]] const Camera& camera() const;
  [[nodiscard]] std::int64_t time_ns(std::size_t frame) const;
  [[nodiscard]] Pose true_pose(std::size_t frame) const;
  /// The frame that next() gives as its number `frame`; moves nothing.
  [[nodiscard]] FramePtr render(std::size_t frame) const;
  /// Exact z in camera coordinates along each pixel centre's ray [m]; 0 where there is sky.
  [[nodiscard]] FloatImage render_depth(std::size_t frame) const;
  /// The town seen from any pose: depth as above.
  [[nodiscard]] FloatImage render_depth(const Pose& T_world_camera) const;
  /// The town seen from any pose, through the lens and the sensor of frame `frame`.
  [[nodiscard]] FramePtr render(const Pose& T_world_camera, std::size_t frame) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace corvid
