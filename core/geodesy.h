#pragma once

#include <Eigen/Core>

#include "corvid/position.h"

namespace corvid {

/// Earth-centred, Earth-fixed coordinates [m]. @pre the position's coordinates are those of a
/// PositionFix without a problem.
[[nodiscard]] Eigen::Vector3d to_ecef(const GeodeticPosition& position);
[[nodiscard]] GeodeticPosition to_geodetic(const Eigen::Vector3d& p_ecef);

/// The tangential frame at one place: x east, y north, z up [m].
class LocalFrame {
 public:
  explicit LocalFrame(const GeodeticPosition& origin);
  [[nodiscard]] const GeodeticPosition& origin() const { return origin_; }
  [[nodiscard]] Eigen::Vector3d to_enu(const Eigen::Vector3d& p_ecef) const {
    return R_ecef_enu_.transpose() * (p_ecef - origin_ecef_);
  }
  [[nodiscard]] Eigen::Vector3d to_ecef(const Eigen::Vector3d& p_enu) const {
    return R_ecef_enu_ * p_enu + origin_ecef_;
  }

 private:
  GeodeticPosition origin_;
  Eigen::Vector3d origin_ecef_;
  Eigen::Matrix3d R_ecef_enu_;
};

}  // namespace corvid
