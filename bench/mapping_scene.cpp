#include "bench/mapping_scene.h"

#include <cmath>
#include <random>
#include <utility>

#include "bench/timing.h"

namespace corvid {
namespace {

/// True depth at the nearest pixel; 0 where it is not known.
double depth_at(const FloatImage& depth, const Eigen::Vector2d& pixel) {
  if (!depth.contains(pixel.x(), pixel.y())) return 0;
  return depth(static_cast<int>(pixel.x() + 0.5), static_cast<int>(pixel.y() + 0.5));
}

}  // namespace

MapSnapshot true_map(const MappingScene& scene, int landmarks_per_view) {
  constexpr double kAgree = 0.02;
  MapSnapshot map;
  map.version = 1;
  if (scene.views.empty()) return map;
  map.camera = scene.views.front().frame->camera;
  const Camera& camera = *map.camera;
  std::vector<std::shared_ptr<Keyframe>> keyframes;
  std::vector<Pose> T_camera_world;
  for (const TrueView& view : scene.views) {
    auto keyframe = std::make_shared<Keyframe>();
    keyframe->id = KeyframeId(static_cast<std::uint32_t>(keyframes.size()));
    keyframe->frame = std::make_shared<const StoredFrame>(view.frame);
    keyframe->T_world_camera = view.T_world_camera;
    keyframes.push_back(std::move(keyframe));
    T_camera_world.push_back(view.T_world_camera.inverse());
  }
  std::vector<Landmark> landmarks;
  std::mt19937 random(7);
  for (const TrueView& view : scene.views) {
    for (int i = 0; i < landmarks_per_view; ++i) {
      const Eigen::Vector2d pixel(random() % static_cast<unsigned>(camera.width_px),
                                  random() % static_cast<unsigned>(camera.height_px));
      const double z = depth_at(view.depth, pixel);
      const auto ray = camera.unproject(pixel);
      if (!(z > 0) || !ray) continue;
      Landmark landmark;
      landmark.id = LandmarkId(static_cast<std::uint32_t>(landmarks.size()));
      landmark.p_world = view.T_world_camera * Eigen::Vector3d(*ray * (z / ray->z()));
      for (std::size_t j = 0; j < keyframes.size(); ++j) {
        const Eigen::Vector3d p = T_camera_world[j] * landmark.p_world;
        const auto seen = camera.project(p);
        if (!seen || !camera.in_image(*seen, 1)) continue;
        if (std::abs(depth_at(scene.views[j].depth, *seen) - p.z()) > kAgree * p.z()) continue;
        keyframes[j]->observations.push_back({landmark.id, *seen});
        ++landmark.observations;
      }
      landmarks.push_back(landmark);
    }
  }
  map.keyframes.assign(keyframes.begin(), keyframes.end());
  map.landmarks = Landmarks(std::move(landmarks));
  return map;
}

DepthScore score_depth(const MappingScene& scene,
                       const std::vector<std::shared_ptr<const DepthMap>>& maps) {
  DepthScore score;
  double known = 0, answers = 0, good_1 = 0, good_2 = 0;
  std::vector<double> errors_m;
  for (const auto& map : maps) {
    const TrueView& view = scene.views[map->keyframe.value];
    ++score.maps;
    for (int y = 0; y < map->depth.height(); ++y) {
      for (int x = 0; x < map->depth.width(); ++x) {
        const auto ray = map->camera.unproject({x, y});
        const auto pixel = ray ? view.frame->camera->project(*ray) : std::nullopt;
        const double truth = pixel ? depth_at(view.depth, *pixel) : 0;
        if (!(truth > 0)) continue;
        ++known;
        const double z = map->depth(x, y);
        if (!(z > 0)) continue;
        ++answers;
        const double error = std::abs(z - truth);
        good_1 += error < 0.01 * truth;
        good_2 += error < 0.02 * truth;
        errors_m.push_back(error);
      }
    }
  }
  if (known > 0) score.answered = answers / known;
  if (answers > 0) {
    score.within_1 = good_1 / answers;
    score.within_2 = good_2 / answers;
    score.median_error_m = median(std::move(errors_m));
  }
  return score;
}

}  // namespace corvid
