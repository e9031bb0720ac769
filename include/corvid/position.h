#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "corvid/error.h"
#include "corvid/pose.h"

namespace corvid {

using Matrix7d = Eigen::Matrix<double, 7, 7>;

/// A place on Earth, WGS84.
struct GeodeticPosition {
  double latitude_deg = 0;   ///< north is positive
  double longitude_deg = 0;  ///< east is positive
  double altitude_m = 0;     ///< above the ellipsoid; above another level surface it will do, too
};

/// Where the camera was, as a satellite receiver, a photograph's EXIF or a file says it. The
/// antenna is taken to be at the camera's centre.
struct PositionFix {
  std::int64_t time_ns = 0;  ///< in the clock of the frames
  std::string frame_name;    ///< if not empty: of the frame of this name, and no time counts
  GeodeticPosition position;
  /// Of east, north, up [m^2]. Default: a plain receiver under an open sky, 5 m and 10 m.
  Eigen::Matrix3d covariance_m2 = Eigen::Vector3d(25, 25, 100).asDiagonal();
  /// Why nothing can be done with it; empty if something can.
  [[nodiscard]] std::string problem() const;
};

/// What is known about the unit of length of a map.
enum class MapScale {
  arbitrary,  ///< one camera alone cannot know it
  metric,     ///< the similarity to the Earth is known
};
[[nodiscard]] std::string_view to_string(MapScale scale);

/// Where a map segment lies on Earth. Immutable once published.
struct MapPlacement {
  MapScale scale = MapScale::arbitrary;
  std::string reason;  ///< why the scale is arbitrary; empty if it is metric
  /// Origin of the local frame east, north, up [m]; the same for all segments of a run.
  GeodeticPosition origin;
  Sim3 T_enu_map;  ///< identity unless metric; `T_enu_map * T_world_camera` is the camera in ENU
  /// Of the similarity's right perturbation (rho [map units], phi [rad], sigma = log of the scale).
  Matrix7d covariance = Matrix7d::Zero();
  int positions = 0;  ///< keyframes with a position
  int inliers = 0;    ///< of these, those that agree
  double rmse_m = 0;  ///< of the inliers
};

/// Port: positions come in while the engine runs.
class PositionSource {
 public:
  virtual ~PositionSource() = default;
  /// What came since the last call, in any order. Called on the backend's thread, once per frame
  /// and once at the end.
  [[nodiscard]] virtual std::vector<PositionFix> take() = 0;
};

/// Positions pushed by a program, from any thread, before or while the engine runs.
///
/// They may come late and out of order: a keyframe waits up to a minute for the positions around
/// its time. Of several with the same time the first counts.
class PositionFeed final : public PositionSource {
 public:
  /// Error: invalid_argument, if nothing can be done with it; then it is left out.
  Expected<void> push(const PositionFix& fix);
  [[nodiscard]] std::vector<PositionFix> take() override;

 private:
  std::mutex mutex_;
  std::vector<PositionFix> waiting_;
};

}  // namespace corvid
