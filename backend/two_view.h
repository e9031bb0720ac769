#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "corvid/camera.h"
#include "corvid/options.h"
#include "corvid/pose.h"

namespace corvid {

/// One feature in two images [px, distorted].
struct PixelPair {
  Eigen::Vector2d a = Eigen::Vector2d::Zero();
  Eigen::Vector2d b = Eigen::Vector2d::Zero();
  double sigma_px = 1;
};

/// A relative pose with what it makes of the pairs.
struct TwoViewMotion {
  Pose T_a_b;                        ///< |translation| = 1
  std::vector<int> index;            ///< the pairs that became points
  std::vector<Eigen::Vector3d> p_a;  ///< their points, in camera a
  double median_parallax_rad = 0;    ///< of all pairs that agree with the motion
};

struct TwoView {
  bool accepted = false;
  std::string reason;    ///< why not, in words for the user
  double explained = 0;  ///< share of the pairs that agree with the motion
  TwoViewMotion motion;  ///< meaningful if accepted
  /// A plane seen twice can have two explanations that are equally good: the other one. A third
  /// view must choose.
  std::optional<TwoViewMotion> rival;
};

/// Motion between two images of one camera (algorithms.md, 6).
///
/// Refused if a rotation alone explains the pairs (standing still included). Else candidates come
/// from the essential matrix (5-point RANSAC) and from the homography (RANSAC; decomposition:
/// Malis and Vargas, INRIA RR-6303), each is judged by the points it triangulates (in front of
/// both cameras, error below max_error_px, ray angle at least min_angle_rad), and the best ones are
/// refined by bundle adjustment. Accepted on start_min_inliers, start_min_parallax_rad (median ray
/// angle) and on 80 % of the agreeing pairs lying in front of both cameras.
/// Deterministic for options.seed.
[[nodiscard]] TwoView two_view(const Camera& camera, std::span<const PixelPair> pairs,
                               const BackendOptions& options);

}  // namespace corvid
