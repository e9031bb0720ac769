#include "replay/flight_curve.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "replay/random.h"

namespace corvid {
namespace {
constexpr double kTurn = 2 * std::numbers::pi;
constexpr int kSteps = 8192;
constexpr double kRoundRadius_m = 76, kHeight_m = 33;

double own_speed(FlightPath path) { return path == FlightPath::facade ? 1.6 : 7; }

/// Distance of the round from the town's middle, as a share of its radius.
double shape(double angle, double phase) {
  return 1 + 0.2 * std::sin(2 * angle + phase) + 0.08 * std::sin(3 * angle + 2 * phase);
}

/// A camera that looks along (yaw, pitch): pitch is negative downwards, roll turns to the right.
Pose looking(const Eigen::Vector3d& position, double yaw, double pitch, double roll) {
  const Eigen::Vector3d forward(std::cos(pitch) * std::cos(yaw), std::cos(pitch) * std::sin(yaw),
                                std::sin(pitch));
  const Eigen::Vector3d right(std::sin(yaw), -std::cos(yaw), 0);
  Eigen::Matrix3d R;
  R << right, forward.cross(right), forward;
  return {Eigen::Matrix3d(R * Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ())), position};
}
}  // namespace

FlightCurve::FlightCurve(const FlightOptions& options, const Town& town, double duration_s)
    : path_(options.path),
      town_(town),
      speed_mps_(options.speed_mps > 0 ? options.speed_mps : own_speed(options.path)),
      duration_s_(duration_s) {
  Random random(mix64(options.seed ^ 0x70617468));
  start_angle_ = random.uniform(0, kTurn);
  phase_ = random.uniform(0, kTurn);

  // Shares of the lap's length, for a round of radius 1.
  std::vector<double> length(kSteps + 1, 0);
  const auto point = [&](int i) -> Eigen::Vector2d {
    const double angle = kTurn * i / kSteps;
    return shape(angle, phase_) * Eigen::Vector2d(std::cos(angle), std::sin(angle));
  };
  for (int i = 1; i <= kSteps; ++i)
    length[static_cast<std::size_t>(i)] =
        length[static_cast<std::size_t>(i - 1)] + (point(i) - point(i - 1)).norm();
  const double whole = length.back();
  for (int i = 0, j = 0; i <= kSteps; ++i) {
    const double goal = whole * i / kSteps;
    while (j < kSteps - 1 && length[static_cast<std::size_t>(j + 1)] < goal) ++j;
    const double a = length[static_cast<std::size_t>(j)],
                 b = length[static_cast<std::size_t>(j + 1)];
    angle_at_.push_back(kTurn * (j + (goal - a) / (b - a)) / kSteps);
  }

  radius_m_ = kRoundRadius_m;
  if (path_ == FlightPath::loop) {
    const double distance = speed_mps_ * duration_s_;
    laps_ = std::max(1.0, std::ceil(distance / (whole * kRoundRadius_m)));
    radius_m_ = std::max(1.0, distance / laps_ / whole);
  }
  length_m_ = whole * radius_m_;
  sway_ = std::max(1, static_cast<int>(std::lround(length_m_ / 100)));
}

Eigen::Vector2d FlightCurve::round_position(double lap) const {
  const double at = (lap - std::floor(lap)) * kSteps;
  const auto i = std::min(static_cast<std::size_t>(at), static_cast<std::size_t>(kSteps - 1));
  const double angle = std::lerp(angle_at_[i], angle_at_[i + 1], at - static_cast<double>(i));
  const double r = radius_m_ * shape(angle, phase_);
  return r * Eigen::Vector2d(std::cos(angle + start_angle_), std::sin(angle + start_angle_));
}

Pose FlightCurve::round_pose(double lap, double pitch_rad) const {
  const Eigen::Vector2d p = round_position(lap);
  constexpr double kLook = 0.004;
  const Eigen::Vector2d ahead = round_position(lap + kLook) - round_position(lap - kLook);
  const auto swing = [&](int times, double shift) {
    return std::sin(kTurn * times * (lap - std::floor(lap)) + phase_ + shift);
  };
  // A short loop sways less, so that its way stays that of its speed.
  const double height = kHeight_m + std::min(3.0, 0.02 * length_m_) * swing(sway_, 0);
  return looking({p.x(), p.y(), height},
                 std::atan2(ahead.y(), ahead.x()) + 0.06 * swing(2 * sway_, 1),
                 pitch_rad + 0.05 * swing(sway_ + 1, 2), 0.05 * swing(2 * sway_ + 1, 3));
}

Pose FlightCurve::facade_pose(double t_s) const {
  // To and fro through the middle street, on its south side, looking north and a little ahead.
  constexpr double kReach_m = 105;
  constexpr double kStart_m = 8;  // where the first house's windows begin
  const double along = kReach_m * std::sin(speed_mps_ * t_s / kReach_m + kStart_m / kReach_m);
  const double across = -3.2 + 0.4 * std::sin(0.31 * t_s);
  const Eigen::Vector2d p = town_.plan.to_world(along, across);
  double ground = 0;  // smoothed, so that the path has no corners
  for (int k = -6; k <= 6; ++k) {
    const Eigen::Vector2d q = town_.plan.to_world(along + 3 * k, across);
    ground += town_.terrain.height(q.x(), q.y()) / 13;
  }
  return looking({p.x(), p.y(), ground + 5.5 + 0.5 * std::sin(0.43 * t_s)},
                 town_.plan.yaw_rad(along, across) + 1.4 + 0.05 * std::sin(0.5 * t_s),
                 0.03 + 0.02 * std::sin(0.7 * t_s), 0.02 * std::sin(0.6 * t_s));
}

Pose FlightCurve::at(double t_s) const {
  constexpr double kSurveyPitch = -0.785, kNadirPitch = -1.5;
  switch (path_) {
    case FlightPath::survey:
      return round_pose(speed_mps_ * t_s / length_m_, kSurveyPitch);
    case FlightPath::nadir:
      return round_pose(speed_mps_ * t_s / length_m_, kNadirPitch);
    case FlightPath::loop: {
      // The last frame must be the first, bit for bit: whole laps are taken off before rounding.
      const double share = t_s == duration_s_ ? 0 : t_s / duration_s_;
      return round_pose(laps_ * share, kSurveyPitch);
    }
    case FlightPath::facade:
      return facade_pose(t_s);
    case FlightPath::hover:
      return round_pose(0, kSurveyPitch);
    case FlightPath::rotation: {
      const Pose start = round_pose(0, kSurveyPitch);
      const Eigen::Vector3d forward = start.R().col(2);
      return looking(start.translation(),
                     std::atan2(forward.y(), forward.x()) + 0.55 * std::sin(0.5 * t_s),
                     kSurveyPitch + 0.12 * std::sin(0.9 * t_s), 0.08 * std::sin(0.7 * t_s));
    }
    case FlightPath::orbit: {
      constexpr double kRadius_m = 85, kOrbitHeight_m = 52;
      const double angle = start_angle_ + speed_mps_ * t_s / kRadius_m;
      const double radius = kRadius_m + 4 * std::sin(0.21 * t_s + phase_);
      const Eigen::Vector3d p(radius * std::cos(angle), radius * std::sin(angle),
                              kOrbitHeight_m + 3 * std::sin(0.3 * t_s + phase_));
      return looking(p, angle + std::numbers::pi + 0.04 * std::sin(0.4 * t_s),
                     -std::atan2(p.z(), radius) + 0.03 * std::sin(0.5 * t_s),
                     0.04 * std::sin(0.35 * t_s));
    }
  }
  return {};
}

}  // namespace corvid
