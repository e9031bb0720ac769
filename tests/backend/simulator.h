#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <random>
#include <vector>

#include "core/alignment.h"
#include "core/tracks.h"
#include "corvid/pose.h"

namespace corvid::test {

enum class Scene { box, corridor, plane, tilted_plane };

/// A flight past random points, as a perfect frontend with noise would report it.
struct Simulation {
  Scene scene = Scene::box;
  /// Pose at a time in [0, 1].
  std::function<Pose(double)> path;
  int frames = 120;
  double rate_hz = 20;
  int keyframe_every = 5;
  int tracks = 400;
  double noise_px = 0.3;
  double outliers = 0.1;  ///< share of tracks that follow nothing
  double death = 0.01;    ///< share of tracks that end per frame
  double reach = 30;      ///< points farther away are not seen
  Camera camera;          ///< that made the pixels
  Camera believed;        ///< that the frames carry
  std::uint64_t seed = 7;
};

inline Camera radtan_camera() {
  Camera c;
  c.model = CameraModel::radtan;
  c.width_px = 752;
  c.height_px = 480;
  c.fx_px = 458.7;
  c.fy_px = 457.3;
  c.cx_px = 367.2;
  c.cy_px = 248.4;
  c.distortion = {-0.28, 0.074, 0.0002, 1.8e-5, 0};
  return c;
}

inline Camera pinhole_camera() {
  Camera c = radtan_camera();
  c.model = CameraModel::pinhole;
  c.distortion = {};
  return c;
}

inline Camera equidistant_camera() {
  Camera c = radtan_camera();
  c.model = CameraModel::equidistant;
  c.fx_px = c.fy_px = 280;
  c.distortion = {-0.01, 0.005, -0.002, 0.0003, 0};
  return c;
}

inline Camera fov_camera() {
  Camera c = radtan_camera();
  c.model = CameraModel::fov;
  c.fx_px = c.fy_px = 300;
  c.distortion = {0.9, 0, 0, 0, 0};
  return c;
}

inline Eigen::Quaterniond wobble(double s, double amplitude_rad) {
  return so3_exp({amplitude_rad * std::sin(11 * s), amplitude_rad * std::cos(7 * s),
                  amplitude_rad * std::sin(5 * s + 1)});
}

/// Along x, looking along z.
inline std::function<Pose(double)> sideways_path(double length) {
  return [length](double s) {
    return Pose(wobble(s, 0.05), {length * s, 0.3 * std::sin(9 * s), 0.4 * std::sin(6 * s)});
  };
}

/// Along z, looking along z: the epipole lies in the image.
inline std::function<Pose(double)> forward_path(double length) {
  return [length](double s) {
    return Pose(wobble(s, 0.03), {0.5 * std::sin(8 * s), 0.1 * std::sin(13 * s), length * s});
  };
}

/// Stays in place and turns about the vertical.
inline std::function<Pose(double)> turning_path(double angle_rad) {
  return [angle_rad](double s) {
    return Pose(so3_exp({0, angle_rad * s, 0}), Eigen::Vector3d::Zero());
  };
}

struct Flight {
  std::vector<FrameTracks> frames;
  std::vector<Pose> truth;              ///< one per frame
  std::vector<TrackId> wrong;           ///< tracks that follow nothing, ascending
  std::vector<Eigen::Vector3d> points;  ///< of each track, by its id
};

class Simulator {
 public:
  explicit Simulator(Simulation simulation) : s_(std::move(simulation)), random_(s_.seed) {
    make_points();
  }

  Flight fly() {
    Flight flight;
    for (int i = 0; i < s_.frames; ++i) {
      const double s = s_.frames > 1 ? static_cast<double>(i) / (s_.frames - 1) : 0.0;
      flight.truth.push_back(s_.path(s));
      flight.frames.push_back(look(i, flight.truth.back(), &flight));
    }
    return flight;
  }

 private:
  struct Live {
    TrackId id;
    std::size_t point = 0;
    bool wrong = false;
    Eigen::Vector2d pixel, drift;
  };

  double uniform(double a, double b) {
    return std::uniform_real_distribution<double>(a, b)(random_);
  }
  double normal() { return std::normal_distribution<double>()(random_); }

  void make_points() {
    const Eigen::Vector3d end = s_.path(1.0).translation();
    const Eigen::Vector3d begin = s_.path(0.0).translation();
    const double length = (end - begin).norm();
    const int count = 2500 + static_cast<int>(250 * length);
    for (int i = 0; i < count; ++i) {
      if (s_.scene == Scene::corridor) {
        const double angle = uniform(0, 6.283), radius = uniform(2.5, 6);
        points_.emplace_back(radius * std::cos(angle), 0.7 * radius * std::sin(angle),
                             uniform(0, length + 30));
        continue;
      }
      const double x = uniform(-12, length + 12), y = uniform(-9, 9);
      const double z = s_.scene == Scene::plane          ? 9.0
                       : s_.scene == Scene::tilted_plane ? 9.0 + 0.6 * y
                                                         : uniform(5, 14);
      points_.emplace_back(x, y, z);
    }
    tracked_.assign(points_.size(), 0);
  }

  std::optional<Eigen::Vector2d> see(const Pose& T_camera_world, std::size_t point) const {
    const Eigen::Vector3d p = T_camera_world * points_[point];
    if (p.z() < 0.3 || p.norm() > s_.reach) return std::nullopt;
    const auto pixel = s_.camera.project(p);
    if (!pixel || !s_.camera.in_image(*pixel, 5)) return std::nullopt;
    return pixel;
  }

  FrameTracks look(int i, const Pose& T_world_camera, Flight* flight) {
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(i));
    frame->time_ns = 1'000'000'000 + static_cast<std::int64_t>(i * 1e9 / s_.rate_hz);
    frame->camera =
        std::make_shared<const Camera>(s_.believed.width_px > 0 ? s_.believed : s_.camera);
    FrameTracks tracks;
    tracks.keyframe = i % s_.keyframe_every == 0;
    const Pose T_camera_world = T_world_camera.inverse();
    std::vector<Live> still;
    for (Live& live : live_) {
      const auto pixel = see(T_camera_world, live.point);
      live.pixel += live.drift;
      const bool keep = uniform(0, 1) >= s_.death &&
                        (live.wrong ? s_.camera.in_image(live.pixel, 5) : pixel.has_value());
      if (!keep) {
        tracked_[live.point] = 0;
        continue;
      }
      if (!live.wrong) live.pixel = *pixel;
      still.push_back(live);
    }
    live_ = std::move(still);
    if (tracks.keyframe) top_up(T_camera_world, flight);
    for (const Live& live : live_) {
      TrackObservation o;
      o.track = live.id;
      o.pixel = live.pixel + s_.noise_px * Eigen::Vector2d(normal(), normal());
      o.score = 0.95F;
      o.covariance_px2 *= std::pow(std::max(0.05, s_.noise_px), 2);
      tracks.observations.push_back(o);
    }
    tracks.frame = std::move(frame);
    return tracks;
  }

  void top_up(const Pose& T_camera_world, Flight* flight) {
    std::vector<std::size_t> order(points_.size());
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
    for (std::size_t k = order.size(); k > 1; --k) std::swap(order[k - 1], order[random_() % k]);
    for (const std::size_t k : order) {
      if (static_cast<int>(live_.size()) >= s_.tracks) break;
      if (tracked_[k] != 0) continue;
      const auto pixel = see(T_camera_world, k);
      if (!pixel) continue;
      Live live;
      live.id = TrackId(next_id_++);
      live.point = k;
      live.pixel = *pixel;
      live.drift.setZero();
      live.wrong = uniform(0, 1) < s_.outliers;
      if (live.wrong) {
        live.drift = {uniform(-4, 4), uniform(-4, 4)};
        flight->wrong.push_back(live.id);
      }
      tracked_[k] = 1;
      flight->points.push_back(points_[k]);
      live_.push_back(live);
    }
  }

  Simulation s_;
  std::mt19937_64 random_;
  std::vector<Eigen::Vector3d> points_;
  std::vector<std::uint8_t> tracked_;
  std::vector<Live> live_;
  std::uint32_t next_id_ = 0;
};

struct Ate {
  PointAlignment alignment;
  std::size_t poses = 0;
  double rmse() const { return alignment.rmse; }
};

/// Error of an estimated trajectory after similarity alignment, in units of the truth.
inline Ate absolute_error(const Trajectory& estimate, const Flight& flight) {
  std::vector<Eigen::Vector3d> source, target;
  for (const StampedPose& p : estimate) {
    for (std::size_t i = 0; i < flight.frames.size(); ++i) {
      if (flight.frames[i].frame->time_ns != p.time_ns) continue;
      source.push_back(p.T_world_camera.translation());
      target.push_back(flight.truth[i].translation());
    }
  }
  return {align_points(source, target, true), source.size()};
}

}  // namespace corvid::test
