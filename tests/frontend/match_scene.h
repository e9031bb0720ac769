#pragma once

#include <Eigen/Core>
#include <cmath>
#include <random>
#include <vector>

#include "corvid/camera.h"
#include "corvid/pose.h"
#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// Random points before three pinholes, the reference at the origin: what disambiguation is tested
/// with.
struct MatchScene {
  Camera camera{CameraModel::pinhole, 640, 480, 500, 500, 320, 240, {}};
  std::vector<Eigen::Vector2d> x_r, x_t, x_a;  ///< exact
  Eigen::Matrix3d F_tr, F_ar, F_at;            ///< x_t^T F_tr x_r = 0, and so on

  /// x_to^T F x_from = 0.
  [[nodiscard]] Eigen::Matrix3d fundamental(const Pose& T_world_from,
                                            const Pose& T_world_to) const {
    const Pose T = T_world_to.inverse() * T_world_from;
    const Eigen::Matrix3d K = camera.K().inverse();
    const Eigen::Matrix3d F = K.transpose() * skew(T.translation()) * T.R() * K;
    return F / F.norm();
  }
};

struct SceneShape {
  Pose T_world_t{so3_exp({0.02, -0.1, 0.05}), {1.0, 0.2, 0.1}};
  Pose T_world_a{so3_exp({-0.05, 0.06, 0.0}), {-0.5, 0.9, 0.2}};
  double nearest = 4, farthest = 12;
};

inline MatchScene make_scene(std::size_t points, std::uint64_t seed, const SceneShape& shape = {}) {
  MatchScene scene;
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> u(0, 1);
  while (scene.x_r.size() < points) {
    const Eigen::Vector2d r(640 * u(random) - 0.5, 480 * u(random) - 0.5);
    // Hills, so that neighbours stay neighbours; and one step.
    const double hills = 0.5 + 0.25 * std::sin(r.x() / 70) + 0.25 * std::cos(r.y() / 90);
    const double z =
        (r.x() > 400 ? 1.0 : 1.2) * (shape.nearest + (shape.farthest - shape.nearest) * hills);
    const Eigen::Vector3d p(z * (r.x() - 320) / 500, z * (r.y() - 240) / 500, z);
    const auto t = scene.camera.project(shape.T_world_t.inverse() * p);
    const auto a = scene.camera.project(shape.T_world_a.inverse() * p);
    if (!t || !a || !scene.camera.in_image(*t)) continue;
    scene.x_r.push_back(r);
    scene.x_t.push_back(*t);
    scene.x_a.push_back(*a);
  }
  const Pose origin{};
  scene.F_tr = scene.fundamental(origin, shape.T_world_t);
  scene.F_ar = scene.fundamental(origin, shape.T_world_a);
  scene.F_at = scene.fundamental(shape.T_world_t, shape.T_world_a);
  return scene;
}

struct Found {
  Eigen::Vector2d x;
  float score;
};
inline MatchSets::Point match_point(const Eigen::Vector2d& x_r, const std::vector<Found>& found) {
  MatchSets::Point point;
  point.x_r = x_r;
  for (const Found& f : found) {
    point.candidates.push_back({f.x, f.score, 0.09 * Eigen::Matrix2d::Identity()});
    point.x_t.push_back(f.x);
  }
  return point;
}

/// A pure sideways motion of a pinhole: epipolar lines are image rows.
inline Eigen::Matrix3d rows_geometry() {
  Eigen::Matrix3d F;
  F << 0, 0, 0, 0, 0, -1, 0, 1, 0;
  return F;
}

/// How candidates are made of a scene. Shares of the points, in this order; the rest is ambiguous:
/// the true candidate and others of about its score.
struct CandidateShape {
  double noise_px = 0.1;
  double unique = 0.4;       ///< the true candidate alone
  double wrong = 0.1;        ///< a wrong candidate alone
  double outstanding = 0.1;  ///< the true candidate, and others of lower scores
  int others = 3;
  double strip_px = 0;  ///< wrong candidates lie this near to the epipolar line; 0: anywhere
};

inline MatchSets make_candidates(const MatchScene& scene, const CandidateShape& shape,
                                 std::uint64_t seed) {
  MatchSets sets;
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> u(0, 1);
  std::normal_distribution<double> noise(0, shape.noise_px);
  for (std::size_t i = 0; i < scene.x_r.size(); ++i) {
    const auto wrong = [&]() -> Eigen::Vector2d {
      const Eigen::Vector2d x(640 * u(random), 480 * u(random));
      if (shape.strip_px == 0) return x;
      const Eigen::Vector3d line = scene.F_tr * scene.x_r[i].homogeneous();
      const Eigen::Vector2d normal = line.head<2>().normalized();
      const double d = line.dot(x.homogeneous()) / line.head<2>().norm();
      return x - (d + shape.strip_px * (2 * u(random) - 1)) * normal;
    };
    const Eigen::Vector2d truth = scene.x_t[i] + Eigen::Vector2d(noise(random), noise(random));
    const double kind = u(random);
    std::vector<Found> found;
    if (kind < shape.unique) {
      found = {{truth, 0.95F}};
    } else if (kind < shape.unique + shape.wrong) {
      found = {{wrong(), 0.85F}};
    } else {
      const bool outstanding = kind < shape.unique + shape.wrong + shape.outstanding;
      found = {{truth, 0.95F}};
      for (int k = 0; k < shape.others; ++k)
        found.push_back({wrong(), outstanding ? 0.8F : 0.95F - 0.01F * static_cast<float>(k + 1)});
      if (!outstanding) std::swap(found[0].x, found[random() % found.size()].x);
    }
    sets.points.push_back(match_point(scene.x_r[i], found));
  }
  return sets;
}

}  // namespace corvid
