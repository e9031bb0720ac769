#include "mapping/view_choice.h"

#include <algorithm>
#include <cmath>

namespace corvid {
namespace {

double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

/// In (0, 1]: 1 at the best angle, falling faster below than above it.
double angle_weight(double angle_rad, double best_rad) {
  const double sigma = angle_rad < best_rad ? 0.4 * best_rad : 1.5 * best_rad;
  const double d = (angle_rad - best_rad) / sigma;
  return std::max(0.02, std::exp(-0.5 * d * d));
}

struct Candidate {
  Neighbour neighbour;
  double score = 0;
};

}  // namespace

std::optional<SceneDepth> scene_depth(const MapSnapshot& map, const Keyframe& keyframe,
                                      double percentile) {
  const Pose T_camera_world = keyframe.T_world_camera.inverse();
  std::vector<double> depths;
  for (const Observation& observation : keyframe.observations) {
    const Landmark* landmark = map.find(observation.landmark);
    if (!landmark) continue;
    const double z = (T_camera_world * landmark->p_world).z();
    if (z > 0 && std::isfinite(z)) depths.push_back(z);
  }
  constexpr std::size_t kMinLandmarks = 8;
  if (depths.size() < kMinLandmarks) return std::nullopt;
  std::sort(depths.begin(), depths.end());
  const auto at = [&](double share) {
    return depths[static_cast<std::size_t>(share * static_cast<double>(depths.size() - 1) + 0.5)];
  };
  return SceneDepth{at(percentile), at(0.5), at(1 - percentile), static_cast<int>(depths.size())};
}

std::vector<Neighbour> choose_neighbours(const MapSnapshot& map, std::size_t reference,
                                         const ViewChoiceOptions& options) {
  const Keyframe& key = *map.keyframes[reference];
  const Eigen::Vector3d c_reference = key.T_world_camera.translation();
  std::vector<Candidate> before, after;
  for (std::size_t i = 0; i < map.keyframes.size(); ++i) {
    const Keyframe& other = *map.keyframes[i];
    if (i == reference || other.segment != key.segment) continue;
    const Eigen::Vector3d c_other = other.T_world_camera.translation();
    if ((c_other - c_reference).squaredNorm() == 0) continue;
    std::vector<double> angles, shifts_px;
    auto b = other.observations.begin();
    for (const Observation& a : key.observations) {
      while (b != other.observations.end() && b->landmark < a.landmark) ++b;
      if (b == other.observations.end()) break;
      if (b->landmark != a.landmark) continue;
      const Landmark* landmark = map.find(a.landmark);
      if (!landmark) continue;
      const double angle =
          angle_between(landmark->p_world - c_reference, landmark->p_world - c_other);
      angles.push_back(angle);
      // Moving a point by one step of inverse depth moves it by about z^2 * step along the ray,
      // which the other view sees under the angle between the rays.
      const double z = (landmark->p_world - c_reference).norm();
      const double z_other = (landmark->p_world - c_other).norm();
      shifts_px.push_back(options.focal_px * std::sin(angle) * z * z * options.inverse_depth_step /
                          std::max(z_other, 1e-12));
    }
    if (static_cast<int>(angles.size()) < options.min_shared) continue;
    const auto middle = static_cast<std::ptrdiff_t>(angles.size() / 2);
    std::nth_element(angles.begin(), angles.begin() + middle, angles.end());
    std::nth_element(shifts_px.begin(), shifts_px.begin() + middle, shifts_px.end());
    const double angle = angles[static_cast<std::size_t>(middle)];
    const double shift = shifts_px[static_cast<std::size_t>(middle)];
    if (angle < options.min_angle_rad || angle > options.max_angle_rad) continue;
    const double overlap =
        static_cast<double>(angles.size()) / static_cast<double>(key.observations.size());
    const double step_weight = shift > 1 ? 1 / (shift * shift) : 1;
    const Candidate candidate{{i, angle, overlap},
                              overlap * angle_weight(angle, options.best_angle_rad) * step_weight};
    (i < reference ? before : after).push_back(candidate);
  }

  const auto better = [](const Candidate& x, const Candidate& y) {
    return x.score != y.score ? x.score > y.score : x.neighbour.index < y.neighbour.index;
  };
  std::sort(before.begin(), before.end(), better);
  std::sort(after.begin(), after.end(), better);
  const auto wanted = static_cast<std::size_t>(std::max(0, options.neighbours));
  // Half from either side; what one side lacks, the other fills.
  const std::size_t half = wanted / 2;
  const std::size_t n_after =
      std::min(after.size(), std::max(half, wanted - std::min(wanted, before.size())));
  const std::size_t n_before = std::min(before.size(), wanted - n_after);
  std::vector<Neighbour> out;
  for (std::size_t i = 0; i < n_before; ++i) out.push_back(before[i].neighbour);
  for (std::size_t i = 0; i < n_after; ++i) out.push_back(after[i].neighbour);
  std::sort(out.begin(), out.end(),
            [](const Neighbour& x, const Neighbour& y) { return x.index < y.index; });
  return out;
}

std::vector<Neighbour> choose_neighbours(std::span<const Pose> T_world_camera, const Camera& camera,
                                         std::size_t reference, const Eigen::Vector3d& p_scene,
                                         const ViewChoiceOptions& options) {
  const Eigen::Vector3d c_reference = T_world_camera[reference].translation();
  std::vector<Candidate> candidates;
  for (std::size_t i = 0; i < T_world_camera.size(); ++i) {
    if (i == reference) continue;
    const auto pixel = camera.project(T_world_camera[i].inverse() * p_scene);
    if (!pixel || !camera.in_image(*pixel)) continue;
    const double angle =
        angle_between(p_scene - c_reference, p_scene - T_world_camera[i].translation());
    if (!(angle >= options.min_angle_rad && angle <= options.max_angle_rad)) continue;
    candidates.push_back({{i, angle, 1}, angle_weight(angle, options.best_angle_rad)});
  }
  std::sort(candidates.begin(), candidates.end(), [](const Candidate& x, const Candidate& y) {
    return x.score != y.score ? x.score > y.score : x.neighbour.index < y.neighbour.index;
  });
  std::vector<Neighbour> out;
  for (const Candidate& c : candidates) {
    if (static_cast<int>(out.size()) < options.neighbours) out.push_back(c.neighbour);
  }
  std::sort(out.begin(), out.end(),
            [](const Neighbour& x, const Neighbour& y) { return x.index < y.index; });
  return out;
}

}  // namespace corvid
