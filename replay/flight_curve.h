#pragma once

#include <Eigen/Core>
#include <vector>

#include "corvid/pose.h"
#include "replay/synthetic_flight.h"
#include "replay/town.h"

namespace corvid {

/// Where the camera is at any time: a smooth function of time, the same for every frame rate.
class FlightCurve {
 public:
  /// @param duration_s  between the first and the last frame; a loop closes after it.
  FlightCurve(const FlightOptions& options, const Town& town, double duration_s);
  /// T_world_camera [m] at t_s after the first frame.
  [[nodiscard]] Pose at(double t_s) const;

 private:
  [[nodiscard]] Eigen::Vector2d round_position(double lap) const;
  [[nodiscard]] Pose round_pose(double lap, double pitch_rad) const;
  [[nodiscard]] Pose facade_pose(double t_s) const;

  FlightPath path_;
  const Town& town_;
  double speed_mps_, duration_s_;
  double radius_m_, length_m_ = 0;  ///< of one lap
  double laps_ = 1;                 ///< of a loop
  double start_angle_, phase_;
  int sway_;                      ///< swings of the attitude per lap
  std::vector<double> angle_at_;  ///< polar angle by share of the lap's length
};

}  // namespace corvid
