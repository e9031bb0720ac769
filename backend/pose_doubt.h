#pragma once

#include <Eigen/Core>
#include <deque>
#include <map>

#include "backend/resect.h"
#include "corvid/pose.h"

namespace corvid {

/// What makes poses less certain than their residuals and landmarks say: residuals that are larger
/// than they were. Then points and pose do not fit each other: something moves, or tracks slip, and
/// what the camera seems to do for some time may be what something else does. That motion counts as
/// unknown for as long as the segment lasts (docs/decisions/pose-covariance.md).
class PoseDoubt {
 public:
  /// Of a pose that was found in a segment; call once for each, in the order of time.
  /// @param step  T_before_now, from the last pose.
  /// @return whether its residuals are odd.
  bool add(int segment, const Resection& r, const Pose& step, double max_error_px);
  /// To be added to the covariance of the pose added last.
  [[nodiscard]] Matrix6d covariance() const { return covariance_; }
  /// A segment starts.
  void start(int segment);
  /// Poses go on elsewhere: what residuals usually are must be learnt anew.
  void jump();
  /// A segment became part of another one; scale: its unit of length in that of the other.
  void join(int from, int to, double scale);

 private:
  Matrix6d covariance_ = Matrix6d::Zero();
  std::deque<double> residuals_;  ///< mean squares of the segment's last frames [px^2]
  int odd_frames_ = 0;            ///< in a row
  Eigen::Vector2d recent_ = Eigen::Vector2d::Zero();  ///< motion in them [map units, rad]
  std::map<int, Eigen::Vector2d> doubted_;            ///< such motion since a segment's start
};

}  // namespace corvid
