#include "backend/resect.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <random>
#include <utility>

#include "core/median.h"

namespace corvid {
namespace {

struct NormalEquations {
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  double cost = 0;
  int used = 0;
};

/// Huber-weighted equations of the points that `use` admits (all if empty). Points outside the
/// camera model cost as much as one 10 widths off, so that losing points is never a gain.
NormalEquations linearize(const Camera& camera, std::span<const PointView> points,
                          const std::vector<std::uint8_t>& use, const Pose& T_world_camera,
                          double huber_px, double sigma_ref_px) {
  NormalEquations n;
  const Eigen::Matrix3d R_camera_world = T_world_camera.R().transpose();
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!use.empty() && use[i] == 0) continue;
    const PointView& point = points[i];
    const Eigen::Vector3d p_camera =
        R_camera_world * (point.p_world - T_world_camera.translation());
    Eigen::Matrix<double, 2, 3> d_point;
    const auto pixel = camera.project(p_camera, &d_point);
    if (!pixel) {
      n.cost += 19 * huber_px * huber_px;
      continue;
    }
    const double scale = sigma_ref_px / point.sigma_px;
    const Eigen::Vector2d error = scale * (*pixel - point.pixel);
    const double e = error.norm();
    const double w = e <= huber_px ? 1 : huber_px / e;
    n.cost += e <= huber_px ? e * e : 2 * huber_px * e - huber_px * huber_px;
    Eigen::Matrix<double, 2, 6> J;
    J.leftCols<3>() = -scale * d_point;
    J.rightCols<3>() = scale * d_point * skew(p_camera);
    n.H.noalias() += w * J.transpose() * J;
    n.g.noalias() += w * J.transpose() * error;
    ++n.used;
  }
  return n;
}

Pose minimise(const Camera& camera, std::span<const PointView> points,
              const std::vector<std::uint8_t>& use, Pose T, double huber_px, double sigma_ref_px,
              int iterations) {
  NormalEquations now = linearize(camera, points, use, T, huber_px, sigma_ref_px);
  double lambda = 1e-6;
  for (int k = 0; k < iterations && now.used >= 3; ++k) {
    Matrix6d damped = now.H;
    damped.diagonal() *= 1 + lambda;
    damped.diagonal().array() += 1e-12 * now.H.trace();
    const Vector6d step = -damped.ldlt().solve(now.g);
    if (!step.allFinite() || step.norm() > 1e6) break;
    const Pose candidate = T * Pose::exp(step);
    NormalEquations then = linearize(camera, points, use, candidate, huber_px, sigma_ref_px);
    if (then.cost <= now.cost) {
      const bool settled = now.cost - then.cost <= 1e-7 * now.cost;
      T = candidate;
      now = then;
      lambda *= 0.1;
      if (settled) break;
    } else {
      lambda = std::max(lambda, 1e-5) * 10;
    }
  }
  return T;
}

void classify(const Camera& camera, std::span<const PointView> points, double max_error_px,
              Resection* r) {
  r->inlier.assign(points.size(), 0);
  r->inliers = 0;
  double sum = 0;
  const Pose T_camera_world = r->T_world_camera.inverse();
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto pixel = camera.project(T_camera_world * points[i].p_world);
    if (!pixel) continue;
    const double e2 = (*pixel - points[i].pixel).squaredNorm();
    if (e2 >= max_error_px * max_error_px) continue;
    r->inlier[i] = 1;
    ++r->inliers;
    sum += e2;
  }
  r->mse_px2 = r->inliers > 0 ? sum / r->inliers : 0;
}

/// Robust refinement from a start: wide first, then narrow on those that agree.
Resection refine(const Camera& camera, std::span<const PointView> points, const Pose& start,
                 const ResectSettings& settings, double sigma_ref_px) {
  Resection r;
  r.T_world_camera = start;
  const double wide = 8 * settings.huber_px;
  r.T_world_camera = minimise(camera, points, {}, r.T_world_camera, wide, sigma_ref_px, 10);
  r.T_world_camera =
      minimise(camera, points, {}, r.T_world_camera, settings.huber_px, sigma_ref_px, 6);
  for (int round = 0; round < 2; ++round) {
    classify(camera, points, settings.max_error_px, &r);
    if (r.inliers < 4) return r;
    r.T_world_camera =
        minimise(camera, points, r.inlier, r.T_world_camera, settings.huber_px, sigma_ref_px, 5);
  }
  classify(camera, points, settings.max_error_px, &r);
  return r;
}

/// Best pose by P3P on random triples, scored on the angle between ray and direction.
std::optional<Pose> p3p_ransac(const Camera& camera, std::span<const PointView> points,
                               const ResectSettings& settings) {
  struct Ray {
    Eigen::Vector3d direction, p_world;
  };
  std::vector<Ray> rays;
  rays.reserve(points.size());
  std::vector<std::size_t> frontal;  // P3P wants image coordinates, so rays well in front
  for (const PointView& point : points) {
    const auto ray = camera.unproject(point.pixel);
    if (!ray) continue;
    if (ray->z() > 0.1) frontal.push_back(rays.size());
    rays.push_back({*ray, point.p_world});
  }
  if (frontal.size() < 4) return std::nullopt;
  const double threshold = settings.max_error_px / std::min(camera.fx_px, camera.fy_px);
  const double threshold2 = threshold * threshold;  // on the squared sine of the angle

  std::mt19937_64 random(settings.seed);
  std::optional<Pose> best;
  double best_score = std::numeric_limits<double>::infinity();
  double trials_needed = settings.max_trials;
  for (int trial = 0; trial < trials_needed; ++trial) {
    std::array<std::size_t, 3> sample{};
    for (std::size_t k = 0; k < 3; ++k) {
      do {
        sample[k] = frontal[random() % frontal.size()];
      } while (std::find(sample.begin(), sample.begin() + static_cast<std::ptrdiff_t>(k),
                         sample[k]) != sample.begin() + static_cast<std::ptrdiff_t>(k));
    }
    std::vector<cv::Point3d> object;
    std::vector<cv::Point2d> image;
    for (const std::size_t i : sample) {
      const Eigen::Vector3d& p = rays[i].p_world;
      object.emplace_back(p.x(), p.y(), p.z());
      const Eigen::Vector3d& d = rays[i].direction;
      image.emplace_back(d.x() / d.z(), d.y() / d.z());
    }
    std::vector<cv::Mat> rotations, translations;
    if (cv::solveP3P(object, image, cv::Mat::eye(3, 3, CV_64F), cv::noArray(), rotations,
                     translations, cv::SOLVEPNP_AP3P) <= 0) {
      continue;
    }
    for (std::size_t s = 0; s < rotations.size(); ++s) {
      const Eigen::Vector3d rotation(rotations[s].at<double>(0), rotations[s].at<double>(1),
                                     rotations[s].at<double>(2));
      const Eigen::Vector3d t(translations[s].at<double>(0), translations[s].at<double>(1),
                              translations[s].at<double>(2));
      if (!rotation.allFinite() || !t.allFinite()) continue;
      const Pose T_camera_world(so3_exp(rotation), t);
      const Eigen::Matrix3d R = T_camera_world.R();
      double score = 0;
      std::size_t agree = 0;
      for (const Ray& ray : rays) {
        const Eigen::Vector3d p = R * ray.p_world + t;
        const double along = p.dot(ray.direction);
        const double sine2 =
            along > 0 ? std::max(0.0, 1 - along * along / p.squaredNorm()) : threshold2;
        score += std::min(sine2, threshold2);
        agree += sine2 < threshold2 ? 1 : 0;
        if (score >= best_score) break;
      }
      if (score >= best_score) continue;
      best_score = score;
      best = T_camera_world.inverse();
      const double share = static_cast<double>(agree) / static_cast<double>(rays.size());
      const double miss = 1 - share * share * share;
      trials_needed = miss <= 0 ? 0
                      : miss >= 1
                          ? settings.max_trials
                          : std::min<double>(settings.max_trials, std::log(1e-4) / std::log(miss));
      trials_needed = std::max(trials_needed, 8.0);
    }
  }
  return best;
}

}  // namespace

Resection resect(const Camera& camera, std::span<const PointView> points,
                 const std::optional<Pose>& predicted, const ResectSettings& settings) {
  Resection best;
  best.inlier.assign(points.size(), 0);
  if (points.size() < 4) return best;
  std::vector<double> sigmas;
  sigmas.reserve(points.size());
  for (const PointView& p : points) sigmas.push_back(p.sigma_px);
  const double sigma_ref_px = upper_median(std::move(sigmas));

  if (predicted && predicted->finite()) {
    best = refine(camera, points, *predicted, settings, sigma_ref_px);
  }
  const int half = static_cast<int>(points.size() / 2);
  if (best.inliers < std::max(settings.min_inliers, half)) {
    if (const auto start = p3p_ransac(camera, points, settings)) {
      Resection other = refine(camera, points, *start, settings, sigma_ref_px);
      other.from_ransac = true;
      if (other.inliers > best.inliers) best = std::move(other);
    }
  }
  if (best.inliers < std::max(settings.min_inliers, 4) || !best.T_world_camera.finite()) {
    best.ok = false;
    return best;
  }
  // Equations of the inliers, in units of a typical observation.
  const NormalEquations n =
      linearize(camera, points, best.inlier, best.T_world_camera, settings.huber_px, sigma_ref_px);
  const double dof = std::max(1, 2 * n.used - 6);
  const double variance = std::max(n.cost / dof, 0.25 * sigma_ref_px * sigma_ref_px);
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(n.H);
  if (!(eigen.eigenvalues()(0) > 1e-12 * eigen.eigenvalues()(5))) return best;
  best.covariance = variance * n.H.inverse();
  best.ok = best.covariance.allFinite();
  return best;
}

}  // namespace corvid
