#pragma once

#include <cmath>
#include <memory>
#include <numbers>
#include <random>
#include <utility>
#include <vector>

#include "backend/map_data.h"
#include "backend/start.h"
#include "tests/backend/simulator.h"

namespace corvid::test {

/// A map as a long flight makes it: rounds over the same ground, 30 units below, with a keyframe
/// every 3 units or so.
struct LongFlightOptions {
  int keyframes = 1000;
  int per_round = 60;
  int landmarks_in_view = 250;
  /// Share of the landmarks that are found again in the next round, under the same id.
  double found = 0.5;
  double drift =
      0;  ///< standard deviation of each step's turn [rad], of log scale and of its share
  std::uint64_t seed = 1;
};

struct LongFlight {
  MapData map;
  std::vector<FrameRecord> frames;
  std::vector<Pose> truth;  ///< of each keyframe

  explicit LongFlight(const LongFlightOptions& options) {
    map.camera = pinhole_camera();
    std::mt19937_64 random(options.seed);
    std::uniform_real_distribution<double> u(0, 1);
    std::normal_distribution<double> normal;
    const double radius = 3.3 * options.per_round / (2 * std::numbers::pi);
    constexpr double kHeight = 30, kFar = 55;
    const double width = 2 * (radius + kFar);
    std::vector<Eigen::Vector3d> points;
    const double view = kHeight * map.camera.width_px / map.camera.fx_px * kHeight *
                        map.camera.height_px / map.camera.fy_px;
    const auto count = static_cast<int>(options.landmarks_in_view * width * width / view);
    for (int i = 0; i < count; ++i) {
      const Eigen::Vector3d p(width * (u(random) - 0.5), width * (u(random) - 0.5),
                              kHeight + 3 * (2 * u(random) - 1));
      if (std::abs(p.head<2>().norm() - radius) < kFar) points.push_back(p);
    }
    struct Track {
      TrackId id;
      int last = -10;
    };
    std::vector<Track> tracks(points.size());
    std::uint32_t next = 0;
    Sim3 T_drifted;
    for (int k = 0; k < options.keyframes; ++k) {
      const double angle = 2 * std::numbers::pi * k / options.per_round;
      truth.emplace_back(wobble(0.01 * k, 0.05),
                         Eigen::Vector3d(radius * std::cos(angle), radius * std::sin(angle), 0));
      if (k > 0) {
        Vector7d error;
        for (int i = 0; i < 7; ++i) error[i] = options.drift * normal(random);
        const Pose step = truth[truth.size() - 2].inverse() * truth.back();
        error.head<3>() *= step.translation().norm();
        T_drifted = T_drifted * Sim3(1, step.rotation(), step.translation()) * Sim3::exp(error);
      } else {
        T_drifted = {1, truth[0].rotation(), truth[0].translation()};
      }
      const Pose T_camera_world = truth.back().inverse();
      std::vector<TrackObservation> seen;
      std::vector<std::pair<TrackId, Eigen::Vector3d>> found;
      for (std::size_t i = 0; i < points.size(); ++i) {
        const Eigen::Vector3d p = T_camera_world * points[i];
        const auto pixel = map.camera.project(p);
        if (!pixel || !map.camera.in_image(*pixel)) continue;
        Track& track = tracks[i];
        const bool follows = track.last == k - 1;
        // The better part of the landmarks is found again and again.
        const double chance = i % 3 == 0 ? std::sqrt(options.found) : options.found;
        if (!follows && (track.last < 0 || u(random) > chance)) track.id = TrackId(next++);
        track.last = k;
        seen.push_back({track.id, *pixel});
        found.emplace_back(track.id, T_drifted * p);
      }
      std::sort(seen.begin(), seen.end(),
                [](const auto& a, const auto& b) { return a.track < b.track; });
      auto frame = std::make_shared<Frame>();
      frame->id = FrameId(static_cast<std::uint32_t>(2 * k));
      frame->time_ns = 500'000'000LL * k;
      (void)map.add_keyframe(frame, 0, {T_drifted.rotation(), T_drifted.translation()}, seen);
      for (const auto& [id, p_world] : found) {
        MapTrack& track = map.tracks.at(id);
        track.landmark = true;
        track.p_world = p_world;
      }
      for (int i = 0; i < 2; ++i)
        frames.push_back({FrameId(static_cast<std::uint32_t>(2 * k + i)),
                          frame->time_ns + 250'000'000LL * i, k, Pose()});
    }
  }
  [[nodiscard]] Sim3 true_similarity(int k) const {
    const Pose& T = truth[static_cast<std::size_t>(k)];
    return {1, T.rotation(), T.translation()};
  }
};

}  // namespace corvid::test
