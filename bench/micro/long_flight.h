#pragma once

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <numbers>
#include <random>
#include <utility>
#include <vector>

#include "backend/map_data.h"
#include "backend/start.h"

namespace corvid {

struct LongFlightOptions {
  int keyframes = 1000;  ///< about 3.3 units apart, 30 above the ground
  int per_round = 60;
  int excursion = 0;  ///< keyframes of a wide round over new ground after the others, and back
  int landmarks_in_view = 250;
  /// Share of the landmarks that are found again in the next round, under the same id; none are in
  /// the excursion, as long as nobody has recognised the place.
  double found = 0.5;
  double drift = 0;  ///< standard deviation of each step's turn [rad], log scale and share of way
  std::uint64_t seed = 1;
};

/// A map as a long flight makes it: rounds over the same ground.
struct LongFlight {
  MapData map;
  std::vector<FrameRecord> frames;
  std::vector<Pose> truth;  ///< of each keyframe

  explicit LongFlight(const LongFlightOptions& options)
      : options_(options),
        random_(options.seed),
        rounds_(options.keyframes - options.excursion),
        radius_(kStep * options.per_round / (2 * std::numbers::pi)) {
    Camera& c = map.camera;
    c.width_px = 752;
    c.height_px = 480;
    c.fx_px = 458.7;
    c.fy_px = 457.3;
    c.cx_px = 367.2;
    c.cy_px = 248.4;
    for (int k = 0; k < options.keyframes; ++k) {
      truth.push_back(pose_of(k));
      scatter(truth.back().translation());
    }
    tracks_.resize(points_.size());
    Sim3 T_world_drifted = true_similarity(0);
    for (int k = 0; k < options.keyframes; ++k) {
      if (k > 0) T_world_drifted = T_world_drifted * step_to(k);
      add(k, T_world_drifted);
    }
  }

  [[nodiscard]] Sim3 true_similarity(int k) const {
    const Pose& T = truth[static_cast<std::size_t>(k)];
    return {1, T.rotation(), T.translation()};
  }
  /// Where keyframe k would be if there were no drift since another.
  [[nodiscard]] Sim3 seen_from(int other, int k) const {
    const Pose& T = map.keyframes[static_cast<std::size_t>(other)].T_world_camera;
    return Sim3(1, T.rotation(), T.translation()) * true_similarity(other).inverse() *
           true_similarity(k);
  }

 private:
  static constexpr double kStep = 3.3, kHeight = 30, kCell = 40;
  using Cell = std::pair<int, int>;
  struct Track {
    TrackId id;
    int last = -10;
  };

  [[nodiscard]] Pose pose_of(int k) const {
    const Eigen::Quaterniond q = so3_exp(
        0.05 * Eigen::Vector3d(std::sin(0.11 * k), std::cos(0.07 * k), std::sin(0.05 * k + 1)));
    const double turn = 2 * std::numbers::pi;
    if (k < rounds_) {
      const double angle = turn * k / options_.per_round;
      return {q, {radius_ * std::cos(angle), radius_ * std::sin(angle), 0}};
    }
    const double wide = kStep * options_.excursion / turn;
    const double angle = turn * (k - rounds_ + 1) / options_.excursion;
    const Eigen::Vector3d start =
        rounds_ > 0 ? pose_of(rounds_ - 1).translation().eval() : Eigen::Vector3d::Zero().eval();
    return {q, start + wide * Eigen::Vector3d(1 - std::cos(angle), std::sin(angle), 0)};
  }

  [[nodiscard]] static Cell cell_of(const Eigen::Vector3d& p) {
    return {static_cast<int>(std::floor(p.x() / kCell)),
            static_cast<int>(std::floor(p.y() / kCell))};
  }

  /// Points on the ground around a position, where there are none yet.
  void scatter(const Eigen::Vector3d& p) {
    const Camera& c = map.camera;
    const double view = kHeight * c.width_px / c.fx_px * kHeight * c.height_px / c.fy_px;
    std::uniform_real_distribution<double> u(0, 1);
    const auto [x, y] = cell_of(p);
    for (int i = x - 1; i <= x + 1; ++i)
      for (int k = y - 1; k <= y + 1; ++k) {
        const auto [at, is_new] = cells_.try_emplace({i, k});
        if (!is_new) continue;
        for (int n = 0; n < options_.landmarks_in_view * kCell * kCell / view; ++n) {
          at->second.push_back(points_.size());
          points_.emplace_back(kCell * (i + u(random_)), kCell * (k + u(random_)),
                               kHeight + 3 * (2 * u(random_) - 1));
        }
      }
  }

  [[nodiscard]] Sim3 step_to(int k) {
    std::normal_distribution<double> normal;
    const auto i = static_cast<std::size_t>(k);
    const Pose step = truth[i - 1].inverse() * truth[i];
    Vector7d error;
    for (int n = 0; n < 7; ++n) error[n] = options_.drift * normal(random_);
    error.head<3>() *= step.translation().norm();
    return Sim3(1, step.rotation(), step.translation()) * Sim3::exp(error);
  }

  void add(int k, const Sim3& T_world_drifted) {
    const Pose T_camera_world = truth[static_cast<std::size_t>(k)].inverse();
    std::vector<TrackObservation> seen;
    std::vector<std::pair<TrackId, Eigen::Vector3d>> landmarks;
    const auto [x, y] = cell_of(truth[static_cast<std::size_t>(k)].translation());
    for (int i = x - 1; i <= x + 1; ++i)
      for (int n = y - 1; n <= y + 1; ++n)
        for (const std::size_t point : cells_.at({i, n})) {
          const Eigen::Vector3d p = T_camera_world * points_[point];
          const auto pixel = map.camera.project(p);
          if (!pixel || !map.camera.in_image(*pixel)) continue;
          const TrackId id = track_of(point, k);
          seen.push_back({id, *pixel});
          landmarks.emplace_back(id, T_world_drifted * p);
        }
    std::sort(seen.begin(), seen.end(),
              [](const auto& a, const auto& b) { return a.track < b.track; });
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(2 * k));
    frame->time_ns = 500'000'000LL * k;
    (void)map.add_keyframe(frame, 0, {T_world_drifted.rotation(), T_world_drifted.translation()},
                           seen);
    for (const auto& [id, p_world] : landmarks) {
      map.tracks.at(id).landmark = true;
      map.tracks.at(id).p_world = p_world;
    }
    for (const int i : {0, 1})
      frames.push_back({FrameId(static_cast<std::uint32_t>(2 * k + i)),
                        frame->time_ns + 250'000'000LL * i, k, Pose()});
  }

  [[nodiscard]] TrackId track_of(std::size_t point, int k) {
    Track& track = tracks_[point];
    std::uniform_real_distribution<double> u(0, 1);
    // The better part of the landmarks is found again and again.
    const double found = point % 3 == 0 ? std::sqrt(options_.found) : options_.found;
    const bool follows = track.last == k - 1;
    const bool again = track.last >= 0 && k < rounds_ && u(random_) < found;
    if (!follows && !again) track.id = TrackId(next_++);
    track.last = k;
    return track.id;
  }

  LongFlightOptions options_;
  std::mt19937_64 random_;
  int rounds_;
  double radius_;
  std::vector<Eigen::Vector3d> points_;
  std::map<Cell, std::vector<std::size_t>> cells_;
  std::vector<Track> tracks_;
  std::uint32_t next_ = 0;
};

}  // namespace corvid
