#include "core/geodesy.h"

#include <GeographicLib/Geocentric.hpp>
#include <vector>

namespace corvid {

Eigen::Vector3d to_ecef(const GeodeticPosition& p) {
  Eigen::Vector3d out;
  GeographicLib::Geocentric::WGS84().Forward(p.latitude_deg, p.longitude_deg, p.altitude_m, out.x(),
                                             out.y(), out.z());
  return out;
}

GeodeticPosition to_geodetic(const Eigen::Vector3d& p_ecef) {
  GeodeticPosition out;
  GeographicLib::Geocentric::WGS84().Reverse(p_ecef.x(), p_ecef.y(), p_ecef.z(), out.latitude_deg,
                                             out.longitude_deg, out.altitude_m);
  return out;
}

LocalFrame::LocalFrame(const GeodeticPosition& origin) : origin_(origin) {
  std::vector<double> rotation(9);  // row by row, local to geocentric
  GeographicLib::Geocentric::WGS84().Forward(origin.latitude_deg, origin.longitude_deg,
                                             origin.altitude_m, origin_ecef_.x(), origin_ecef_.y(),
                                             origin_ecef_.z(), rotation);
  R_ecef_enu_ = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rotation.data());
}

}  // namespace corvid
