#pragma once

#include <memory>
#include <random>
#include <vector>

#include "corvid/map.h"
#include "scenes/plane_views.h"

namespace corvid::testing {

/// A map snapshot with true poses and landmarks on the true surface: what a perfect backend would
/// publish after seeing `poses`.
inline MapSnapshot true_map(const PlaneScene& scene, const Camera& camera,
                            const std::vector<Pose>& poses, int landmarks_per_view = 60) {
  MapSnapshot map;
  map.version = 1;
  map.camera = std::make_shared<const Camera>(camera);
  std::vector<FloatImage> depths;
  std::vector<std::shared_ptr<Keyframe>> keyframes;
  for (const Pose& T : poses) {
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(keyframes.size()));
    frame->grey = scene.render(camera, T);
    frame->camera = map.camera;
    auto keyframe = std::make_shared<Keyframe>();
    keyframe->id = KeyframeId(static_cast<std::uint32_t>(keyframes.size()));
    keyframe->frame = std::make_shared<const StoredFrame>(frame);
    keyframe->T_world_camera = T;
    keyframes.push_back(keyframe);
    depths.push_back(scene.depth(camera, T));
  }
  std::vector<Landmark> landmarks;
  std::mt19937 random(5);
  for (std::size_t k = 0; k < poses.size(); ++k) {
    for (int i = 0; i < landmarks_per_view; ++i) {
      const int x = static_cast<int>(random() % static_cast<unsigned>(camera.width_px));
      const int y = static_cast<int>(random() % static_cast<unsigned>(camera.height_px));
      const double z = depths[k](x, y);
      if (!(z > 0)) continue;
      const Eigen::Vector3d ray = camera.unproject({x, y}).value();
      Landmark landmark;
      landmark.id = LandmarkId(static_cast<std::uint32_t>(landmarks.size()));
      landmark.p_world = poses[k] * (ray * (z / ray.z()));
      for (std::size_t j = 0; j < poses.size(); ++j) {
        const Eigen::Vector3d p = poses[j].inverse() * landmark.p_world;
        const auto pixel = camera.project(p);
        if (!pixel || !camera.in_image(*pixel, 1)) continue;
        const double seen =
            depths[j](static_cast<int>(pixel->x() + 0.5), static_cast<int>(pixel->y() + 0.5));
        if (std::abs(seen - p.z()) > 0.03 * p.z()) continue;
        keyframes[j]->observations.push_back({landmark.id, *pixel});
        ++landmark.observations;
      }
      landmarks.push_back(landmark);
    }
  }
  map.keyframes.assign(keyframes.begin(), keyframes.end());
  map.landmarks = Landmarks(std::move(landmarks));
  return map;
}

}  // namespace corvid::testing
