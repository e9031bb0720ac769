#include "backend/two_view.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <random>

#include "backend/bundle.h"
#include "backend/triangulate.h"
#include "core/median.h"

namespace corvid {
namespace {

struct RayPair {
  int index;  // in the caller's pairs
  Eigen::Vector3d a, b;
};

/// Share of pairs that a rotation alone explains: robust Wahba problem, reweighted from the
/// previous residuals (Kabsch, Acta Cryst. A32, 1976).
double share_explained_by_rotation(const std::vector<RayPair>& rays, double threshold_rad) {
  std::vector<double> weight(rays.size(), 1.0);
  double share = 0;
  for (int round = 0; round < 15; ++round) {
    Eigen::Matrix3d M = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < rays.size(); ++i) {
      M += weight[i] * rays[i].a * rays[i].b.transpose();
    }
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(M, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Eigen::Matrix3d D = Eigen::Matrix3d::Identity();
    D(2, 2) = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1;
    const Eigen::Matrix3d R_a_b = svd.matrixU() * D * svd.matrixV().transpose();
    std::size_t explained = 0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const double residual = angle_between(rays[i].a, R_a_b * rays[i].b) / threshold_rad;
      explained += residual < 1 ? 1 : 0;
      weight[i] = 1 / std::max(1.0, residual * residual);
    }
    share = static_cast<double>(explained) / static_cast<double>(rays.size());
  }
  return share;
}

struct Judged {
  TwoViewMotion motion;
  int in_front = 0;           ///< pairs that agree, in front of both cameras
  int behind = 0;             ///< pairs that would agree if they were not behind one
  double cost = 0;            ///< sum of squared errors of all pairs, each at most max_error_px^2
  std::vector<int> agreeing;  ///< pairs in front, whatever their angle
  std::vector<Eigen::Vector3d> agreeing_a;  ///< their points, in camera a
};

/// What a motion makes of the pairs.
Judged judge(const Camera& camera, std::span<const PixelPair> pairs,
             const std::vector<RayPair>& rays, const Pose& T_a_b, const BackendOptions& options) {
  Judged result;
  result.motion.T_a_b = T_a_b;
  const Pose T_b_a = T_a_b.inverse();
  const double max2 = options.max_error_px * options.max_error_px;
  std::vector<double> parallax;
  result.cost = max2 * static_cast<double>(rays.size());
  for (const RayPair& ray : rays) {
    const PixelPair& pair = pairs[static_cast<std::size_t>(ray.index)];
    const Eigen::Vector3d direction_b = T_a_b.rotation() * ray.b;
    const double angle = angle_between(ray.a, direction_b);
    // Depths along both rays at their closest approach.
    const double c = ray.a.dot(direction_b);
    const double determinant = 1 - c * c;
    if (!(determinant > 1e-14)) continue;
    const Eigen::Vector3d& t = T_a_b.translation();
    const double depth_a = (t.dot(ray.a) - c * t.dot(direction_b)) / determinant;
    const double depth_b = (c * t.dot(ray.a) - t.dot(direction_b)) / determinant;
    const Eigen::Vector3d p_a = 0.5 * (depth_a * ray.a + (t + depth_b * direction_b));
    if (depth_a <= 0 || depth_b <= 0) {
      // Errors of a point behind the cameras, seen through the centre: does the pair agree at all?
      const double miss = std::abs(t.dot(ray.a.cross(direction_b))) / std::sqrt(determinant);
      const double near = std::min(std::abs(depth_a), std::abs(depth_b));
      if (angle >= options.min_angle_rad && miss * camera.fx_px < options.max_error_px * near) {
        ++result.behind;
      }
      continue;
    }
    const auto pixel_a = camera.project(p_a);
    const auto pixel_b = camera.project(T_b_a * p_a);
    if (!pixel_a || !pixel_b) continue;
    const double ea = (*pixel_a - pair.a).squaredNorm();
    const double eb = (*pixel_b - pair.b).squaredNorm();
    if (ea >= max2 || eb >= max2) continue;
    parallax.push_back(angle);
    ++result.in_front;
    result.cost += 0.5 * (ea + eb) - max2;
    result.agreeing.push_back(ray.index);
    result.agreeing_a.push_back(p_a);
    if (angle < options.min_angle_rad) continue;
    result.motion.index.push_back(ray.index);
    result.motion.p_a.push_back(p_a);
  }
  result.motion.median_parallax_rad = upper_median(std::move(parallax));
  return result;
}

/// Bundle adjustment of the motion with its points; the baseline stays 1.
Pose refine(const Camera& camera, std::span<const PixelPair> pairs, const Judged& judged,
            const BackendOptions& options) {
  const Pose& T_a_b = judged.motion.T_a_b;
  BundleProblem problem;
  problem.camera = camera;
  problem.T_world_camera = {Pose(), T_a_b};
  problem.fixed = {1, 0};
  problem.points = judged.agreeing_a;
  problem.hold_distance = {{0, 1}};
  for (std::size_t i = 0; i < judged.agreeing.size(); ++i) {
    const PixelPair& pair = pairs[static_cast<std::size_t>(judged.agreeing[i])];
    const int point = static_cast<int>(i);
    problem.observations.push_back({0, point, pair.a, pair.sigma_px});
    problem.observations.push_back({1, point, pair.b, pair.sigma_px});
  }
  BundleSettings settings;
  settings.huber_px = options.huber_px;
  settings.max_iterations = 15;
  if (!adjust(problem, settings).ok) return T_a_b;
  const Pose& T = problem.T_world_camera[1];
  const double length = T.translation().norm();
  return length > 0 ? Pose(T.rotation(), T.translation() / length) : T_a_b;
}

Eigen::Matrix3d to_eigen(const cv::Mat& m) {
  Eigen::Matrix3d out;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) out(r, c) = m.at<double>(r, c);
  }
  return out;
}

void add_candidate(const Eigen::Matrix3d& R_b_a, const Eigen::Vector3d& t_b_a,
                   std::vector<Pose>* candidates) {
  if (!R_b_a.allFinite() || !(t_b_a.norm() > 1e-9)) return;
  const Pose T_a_b = Pose(R_b_a, t_b_a.normalized()).inverse();
  if (T_a_b.finite()) candidates->push_back(T_a_b);
}

/// Relative poses that the pairs may have come from.
std::vector<Pose> candidate_motions(std::vector<RayPair> rays, double threshold,
                                    std::uint64_t seed) {
  std::mt19937_64 random(seed);  // OpenCV's own generator has a fixed seed: the order is ours
  for (std::size_t i = rays.size(); i > 1; --i) std::swap(rays[i - 1], rays[random() % i]);
  std::vector<cv::Point2d> a, b;
  for (const RayPair& ray : rays) {
    if (ray.a.z() < 0.1 || ray.b.z() < 0.1) continue;  // no image coordinates on a plane
    a.emplace_back(ray.a.x() / ray.a.z(), ray.a.y() / ray.a.z());
    b.emplace_back(ray.b.x() / ray.b.z(), ray.b.y() / ray.b.z());
  }
  std::vector<Pose> candidates;
  if (a.size() < 8) return candidates;
  const cv::Mat K = cv::Mat::eye(3, 3, CV_64F);
  const cv::Mat E = cv::findEssentialMat(a, b, K, cv::RANSAC, 0.999, threshold);
  for (int row = 0; row + 3 <= E.rows; row += 3) {
    cv::Mat R1, R2, t;
    cv::decomposeEssentialMat(E.rowRange(row, row + 3), R1, R2, t);
    const Eigen::Vector3d t_b_a(t.at<double>(0), t.at<double>(1), t.at<double>(2));
    for (const cv::Mat& R : {R1, R2}) {
      add_candidate(to_eigen(R), t_b_a, &candidates);
      add_candidate(to_eigen(R), -t_b_a, &candidates);
    }
  }
  const cv::Mat H = cv::findHomography(a, b, cv::RANSAC, 2 * threshold, cv::noArray(), 1000, 0.999);
  if (!H.empty()) {
    std::vector<cv::Mat> R, t, normal;
    cv::decomposeHomographyMat(H, K, R, t, normal);
    for (std::size_t i = 0; i < R.size(); ++i) {
      add_candidate(to_eigen(R[i]), {t[i].at<double>(0), t[i].at<double>(1), t[i].at<double>(2)},
                    &candidates);
    }
  }
  return candidates;
}

bool differ(const Pose& a, const Pose& b) {
  constexpr double kRotationRad = 0.02, kDirectionRad = 0.1;
  return so3_log(a.rotation().conjugate() * b.rotation()).norm() > kRotationRad ||
         angle_between(a.translation(), b.translation()) > kDirectionRad;
}

}  // namespace

TwoView two_view(const Camera& camera, std::span<const PixelPair> pairs,
                 const BackendOptions& options) {
  TwoView result;
  std::vector<RayPair> rays;
  rays.reserve(pairs.size());
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const auto a = camera.unproject(pairs[i].a);
    const auto b = camera.unproject(pairs[i].b);
    if (a && b) rays.push_back({static_cast<int>(i), *a, *b});
  }
  const auto enough = static_cast<std::size_t>(std::max(8, options.start_min_inliers));
  if (rays.size() < enough) {
    result.reason = "too few tracks reach from one keyframe to the other";
    return result;
  }
  const double focal = std::min(camera.fx_px, camera.fy_px);
  constexpr double kRotationShare = 0.8;
  if (share_explained_by_rotation(rays, options.max_error_px / focal) > kRotationShare) {
    result.reason = "the camera stands still or only turns";
    return result;
  }

  std::vector<Judged> judged;
  for (const Pose& T : candidate_motions(rays, 0.5 * options.max_error_px / focal, options.seed)) {
    judged.push_back(judge(camera, pairs, rays, T, options));
  }
  // By cost over all pairs, not by the number of points: wrong motions can have wider angles.
  const auto better = [](const Judged& x, const Judged& y) { return x.cost < y.cost; };
  std::stable_sort(judged.begin(), judged.end(), better);
  if (judged.size() > 3) judged.resize(3);
  for (Judged& candidate : judged) {
    for (int round = 0; round < 2 && candidate.in_front >= 8; ++round) {
      const Pose T = refine(camera, pairs, candidate, options);
      candidate = judge(camera, pairs, rays, T, options);
    }
  }
  std::stable_sort(judged.begin(), judged.end(), better);
  if (judged.empty() || judged.front().motion.index.size() < enough) {
    result.reason = "too few points agree with one motion";
    return result;
  }
  const Judged& best = judged.front();
  const TwoViewMotion& motion = best.motion;
  if (motion.median_parallax_rad < options.start_min_parallax_rad) {
    result.reason = "too little parallax";
    return result;
  }
  constexpr double kInFront = 0.8, kExplained = 0.4;
  const double in_front = best.in_front;
  if (in_front < kInFront * (in_front + best.behind) ||
      in_front < kExplained * static_cast<double>(rays.size())) {
    result.reason = "the tracks do not agree with one motion";
    return result;
  }
  result.accepted = true;
  result.explained = in_front / static_cast<double>(rays.size());
  result.motion = motion;
  for (std::size_t i = 1; i < judged.size(); ++i) {
    const TwoViewMotion& other = judged[i].motion;
    if (other.index.size() >= enough && judged[i].cost < 1.2 * best.cost &&
        differ(other.T_a_b, motion.T_a_b)) {
      result.rival = other;
      break;
    }
  }
  return result;
}

}  // namespace corvid
