#pragma once

#include <Eigen/Core>
#include <utility>

namespace corvid {

/// The pair of points closest to x_r <-> x_t [px], by the sum of both squared distances (4.33),
/// that satisfies x_t^T F x_r = 0 exactly: the real roots of a polynomial of degree six (Hartley
/// and Sturm, Triangulation, CVIU 1997).
///
/// @param F  rank 2.
/// @return the pair as it was where it satisfies F already, and where F or a point is not finite.
[[nodiscard]] std::pair<Eigen::Vector2d, Eigen::Vector2d> correct_match(const Eigen::Matrix3d& F,
                                                                        const Eigen::Vector2d& x_r,
                                                                        const Eigen::Vector2d& x_t);

}  // namespace corvid
