#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>
#include <string>

#include "corvid/run_result.h"
#include "scenes/mesh_shapes.h"

namespace corvid {

/// A ray's first hit with the sphere of the made-up run; 0 if it misses.
inline double sphere_hit(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                         const Eigen::Vector3d& centre, double radius) {
  const double b = direction.dot(centre - origin);
  const double d = b * b - (centre - origin).squaredNorm() + radius * radius;
  return d < 0 ? 0 : b - std::sqrt(d);
}

/// A made-up run of everything a report shows: a camera that passes a coloured ball, with a start,
/// a degraded stretch, a loss and a new segment. Nothing in it was estimated.
inline RunResult made_up_run(int frames = 120) {
  const Eigen::Vector3d centre(0, 0.3, 9);
  constexpr double kRadius = 3;
  RunResult run;
  run.device = "a device <of> \"some\" kind";
  run.source = {"image folder",
                "/data/A & B/<flight> 'one'",
                130,
                20.0,
                false,
                false,
                true,
                nullptr,
                IntrinsicsOrigin::exif,
                false,
                {"The focal length comes from EXIF."}};
  auto camera = std::make_shared<Camera>();
  camera->width_px = 320;
  camera->height_px = 240;
  camera->fx_px = camera->fy_px = 260;
  camera->cx_px = 159.5;
  camera->cy_px = 119.5;
  run.source.camera = camera;
  run.counts = {
      static_cast<std::uint64_t>(frames),
      2,
      8,
      {"frame 17: a\xff.png: the file ends after 1024 bytes", "frame 31: <b>.png: missing"}};
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  auto map = std::make_shared<MapSnapshot>();
  map->camera = camera;
  std::vector<Landmark> landmarks;
  for (std::uint32_t i = 0; i < 4000; ++i) {
    Eigen::Vector3d n(normal(random), normal(random), normal(random));
    n.normalize();
    Landmark l;
    l.id = LandmarkId(i);
    l.p_world = centre + kRadius * n;
    l.colour = {static_cast<std::uint8_t>(127 + 127 * n.x()),
                static_cast<std::uint8_t>(127 + 127 * n.y()),
                static_cast<std::uint8_t>(127 + 127 * n.z())};
    l.observations = 3;
    landmarks.push_back(l);
  }
  map->landmarks = Landmarks(std::move(landmarks));
  for (int i = 0; i < frames; ++i) {
    const double s = static_cast<double>(i) / frames;
    PoseEvent e;
    e.frame = FrameId(static_cast<std::uint32_t>(i));
    e.time_ns = 1'500'000'000'000'000'000 + i * 50'000'000LL;
    const double yaw = -0.9 * std::sin(3 * (s - 0.0));
    const Pose T(Eigen::Quaterniond(Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitY())),
                 {5 * std::sin(3 * s), -1.2 * s, 5 - 5 * std::cos(3 * s)});
    const bool starting = i<frames / 12, lost = i> frames * 6 / 10 && i < frames * 65 / 100;
    const bool degraded = i > frames * 55 / 100 && !lost && i < frames * 7 / 10;
    e.state = starting   ? TrackingState::starting
              : lost     ? TrackingState::lost
              : degraded ? TrackingState::degraded
                         : TrackingState::tracking;
    if (starting) e.reason = "too little parallax";
    if (lost) e.reason = "fewer than 20 landmarks agree";
    if (degraded) e.reason = "few tracks & little texture";
    e.tracks = static_cast<int>(700 - 350 * degraded - 600 * lost + 30 * normal(random));
    e.latency_ms = 18 + 4 * std::abs(normal(random)) + (i % 20 == 0 ? 30 : 0);
    e.segment = i > frames * 6 / 10 ? 1 : 0;
    if (!starting && !lost) {
      e.T_world_camera = T;
      e.inliers = static_cast<int>(e.tracks * 0.8);
      e.mse_px2 = 0.3 + 0.05 * std::abs(normal(random)) + 0.5 * degraded;
      run.trajectory.push_back({e.time_ns, T});
    }
    e.keyframe = e.T_world_camera && i % 10 == 0;
    if (e.keyframe) {
      auto frame = std::make_shared<Frame>();
      frame->id = e.frame;
      frame->time_ns = e.time_ns;
      frame->name = "<img> & " + std::to_string(i) + ".png";
      frame->camera = camera;
      frame->grey = GreyImage(320, 240, 150);
      DepthMap depth;
      depth.keyframe = KeyframeId(static_cast<std::uint32_t>(map->keyframes.size()));
      depth.camera = *camera;
      depth.T_world_camera = T;
      depth.depth = FloatImage(320, 240);
      depth.confidence = FloatImage(320, 240);
      for (int y = 0; y < 240; ++y) {
        for (int x = 0; x < 320; ++x) {
          const Eigen::Vector3d ray = *camera->unproject({x, y});
          const double hit = sphere_hit(T.translation(), T.rotation() * ray, centre, kRadius);
          if (hit <= 0 || (x / 9 + y / 7) % 11 == 0) continue;
          depth.depth(x, y) = static_cast<float>(hit * ray.z());
          depth.confidence(x, y) =
              static_cast<float>(0.6 + 0.39 * std::sin(x * 0.1) * std::cos(y * 0.07));
          const Eigen::Vector3d n = (T * (hit * ray) - centre) / kRadius;
          frame->grey(x, y) = static_cast<std::uint8_t>(
              std::clamp(120 + 60 * std::sin(9 * n.x()) * std::sin(9 * n.y()), 0.0, 255.0));
        }
      }
      run.depth_maps.emplace_back(depth);
      auto keyframe = std::make_shared<Keyframe>();
      keyframe->id = depth.keyframe;
      keyframe->segment = e.segment;
      keyframe->frame = std::make_shared<const StoredFrame>(frame);
      keyframe->T_world_camera = T;
      for (const Landmark& l : map->landmarks) {
        const auto pixel = camera->project(T.inverse() * l.p_world);
        if (pixel && camera->in_image(*pixel) && l.id.value % 3 == 0) {
          keyframe->observations.push_back({l.id, *pixel});
        }
      }
      map->keyframes.push_back(keyframe);
    }
    run.events.push_back(e);
  }
  run.map = map;
  run.mesh = coloured_sphere(centre.cast<float>(), kRadius, 60, 90);
  run.voxel_size = 0.05;
  run.stages = {{"frontend", static_cast<std::uint64_t>(frames), 12.1, 19.5, 31, 1.6},
                {"frontend/search", static_cast<std::uint64_t>(frames), 7.3, 9.5, 12, 0.9},
                {"backend", static_cast<std::uint64_t>(frames), 3.1, 22.5, 41, 0.8},
                {"mapping/<depth>", 11, 120.5, 180, 180, 1.4}};
  run.wall_s = 4.2;
  run.peak_memory_bytes = 412'000'000;
  run.notes = {"A note with <tags> & \"quotes\"."};
  return run;
}

/// The truth of made_up_run(): twice its size, turned, with a wobble.
inline Trajectory made_up_truth(const RunResult& run) {
  const Sim3 T_truth_world(
      2, Eigen::Quaterniond(Eigen::AngleAxisd(0.8, Eigen::Vector3d(1, 2, 3).normalized())),
      {100, 200, 30});
  Trajectory truth;
  for (std::size_t i = 0; i < run.trajectory.size(); ++i) {
    Pose T = T_truth_world * run.trajectory[i].T_world_camera;
    const double w = 0.15 * std::sin(0.2 * static_cast<double>(i));
    T = Pose(T.rotation(), T.translation() + Eigen::Vector3d(w, 0.5 * w, -w));
    truth.push_back({run.trajectory[i].time_ns, T});
  }
  return truth;
}

}  // namespace corvid
