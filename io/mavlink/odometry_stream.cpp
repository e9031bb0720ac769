#include "io/mavlink/odometry_stream.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/clock.h"

namespace corvid {
namespace {

using mavlink::Covariance21;
using mavlink::Odometry;

Covariance21 upper_triangle(const Matrix6d& m) {
  Covariance21 out;
  std::size_t at = 0;
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) out[at++] = static_cast<float>(m(row, column));
  }
  return out;
}

/// First element NaN, as the message's definition has it; the rest is zero.
Covariance21 unknown_covariance() {
  Covariance21 out{};
  out[0] = std::numeric_limits<float>::quiet_NaN();
  return out;
}

bool finite(const Odometry& m) {
  bool all = true;
  for (const float value : {m.x, m.y, m.z, m.q[0], m.q[1], m.q[2], m.q[3], m.vx, m.vy, m.vz,
                            m.rollspeed, m.pitchspeed, m.yawspeed}) {
    all = all && std::isfinite(value);
  }
  return all;
}

/// The share of a new value in a mean that follows the last twenty or so.
double share(int values_before) { return 1.0 / std::min(values_before + 1, 20); }

}  // namespace

Pose OdometryStream::body_of(const Measured& m) const {
  return body_pose(m.T_world_camera, m.covariance, *past_.back().placement, options_.T_body_camera)
      .T_ned_body;
}

OdometryStream::Velocity OdometryStream::velocity(const Measured& older,
                                                  const Measured& newer) const {
  const double dt_s = difference_s(newer.time_ns, older.time_ns);
  const Pose a = body_of(older), b = body_of(newer);
  return {(b.translation() - a.translation()) / dt_s,
          so3_log(a.rotation().conjugate() * b.rotation()) / dt_s};
}

/// A new placement on Earth moves all poses. Within three times what was said to be their
/// uncertainty that is what a measurement may do; more is a jump.
void OdometryStream::count_replacement(const Measured& now) {
  const Measured& last = past_.back();
  if (last.placement == now.placement) return;
  const auto at = [&](const MapPlacement& placement) {
    return body_pose(last.T_world_camera, last.covariance, placement, options_.T_body_camera);
  };
  const BodyPose before = at(*last.placement), after = at(*now.placement);
  const Eigen::Vector3d moved_m = after.T_ned_body.translation() - before.T_ned_body.translation();
  const double turned_rad =
      so3_log(after.T_ned_body.rotation() * before.T_ned_body.rotation().conjugate()).norm();
  const Eigen::Vector<double, 6> variances = before.covariance.diagonal();
  if (moved_m.squaredNorm() > 9 * variances.head<3>().sum() ||
      turned_rad * turned_rad > 9 * variances.tail<3>().sum()) {
    ++replacements_;
  }
}

void OdometryStream::learn(const Velocity& before) {
  const Eigen::Vector3d linear = velocity_.linear_ned - before.linear_ned;
  const Eigen::Vector3d angular = velocity_.angular_body - before.angular_body;
  const double weight = share(changes_);
  linear_changes_ += weight * (linear * linear.transpose() - linear_changes_);
  angular_changes_ += weight * (angular * angular.transpose() - angular_changes_);
  ++changes_;
}

/// Extrapolations at equal distances until the next pose is expected, then, half a distance later
/// so that a pose which is only a little late comes first, on until there is one.
void OdometryStream::plan(double interval_s) {
  step_ = 0;
  if (options_.rate_hz <= 0 || changes_ < kLeastChanges) return;
  constexpr double kTolerance = 0.1;  // a camera that is a little slower than the rate will do
  between_ = std::max(1, static_cast<int>(std::ceil(interval_s * options_.rate_hz - kTolerance)));
  spacing_s_ = between_ > 1 ? interval_s / between_ : 1 / options_.rate_hz;
  step_ = 1;
  while (offset_s(step_) <= kMostBeyond_s && stamp_ns(step_) <= last_sent_ns_) ++step_;
}

double OdometryStream::offset_s(int step) const {
  return spacing_s_ * (step < between_ ? step : step + 0.5);
}

std::int64_t OdometryStream::stamp_ns(int step) const {
  return past_.back().time_ns + static_cast<std::int64_t>(1e9 * offset_s(step));
}

std::optional<Odometry> OdometryStream::add(const PoseEvent& event, std::int64_t arrival_ns) {
  const bool usable = event.T_world_camera && event.T_world_camera->finite() && event.placement &&
                      event.scale == MapScale::metric && event.state != TrackingState::lost &&
                      event.state != TrackingState::starting;
  if (!usable) {
    past_.clear();
    return std::nullopt;
  }
  const double age_s = difference_s(arrival_ns, event.time_ns);
  if (std::abs(age_s) > kMostAge_s) {
    ++counts_.stale;
    past_.clear();
    return std::nullopt;
  }
  const Measured now{event.time_ns, arrival_ns,   *event.T_world_camera, event.covariance,
                     event.state,   event.resets, event.placement};
  if (!past_.empty()) {
    const double gap_s = difference_s(now.time_ns, past_.back().time_ns);
    if (gap_s < kLeastGap_s) return std::nullopt;
    if (gap_s > kMostGap_s || past_.back().resets != now.resets) {
      past_.clear();
    } else {
      count_replacement(now);
    }
  }
  past_.push_back(now);
  if (past_.size() > 3) past_.pop_front();
  step_ = 0;
  if (past_.size() < 2) return std::nullopt;

  const Measured& previous = past_[past_.size() - 2];
  body_ = body_pose(now.T_world_camera, now.covariance, *now.placement, options_.T_body_camera);
  velocity_ = velocity(previous, now);
  interval_s_ = difference_s(now.time_ns, previous.time_ns);
  if (past_.size() == 3) learn(velocity(past_[0], past_[1]));
  const Odometry m = message(0);
  if (!finite(m)) return std::nullopt;
  const bool overtaken = now.time_ns <= last_sent_ns_;
  if (!overtaken) last_sent_ns_ = now.time_ns;
  plan(interval_s_);
  if (overtaken) {
    ++counts_.late;
    return std::nullopt;
  }
  ++counts_.measured;
  return m;
}

std::optional<std::int64_t> OdometryStream::due_ns() const {
  if (past_.empty() || step_ == 0 || offset_s(step_) > kMostBeyond_s) return std::nullopt;
  return past_.back().arrival_ns + static_cast<std::int64_t>(1e9 * offset_s(step_));
}

std::optional<Odometry> OdometryStream::extrapolate(std::int64_t now_ns) {
  std::optional<int> newest;
  for (auto due = due_ns(); due && *due <= now_ns; due = due_ns()) newest = step_++;
  if (!newest) return std::nullopt;
  const Odometry m = message(offset_s(*newest));
  if (!finite(m)) return std::nullopt;
  last_sent_ns_ = stamp_ns(*newest);
  ++counts_.extrapolated;
  return m;
}

/// @param beyond_s  the newest pose, >= 0.
Odometry OdometryStream::message(double beyond_s) const {
  const Measured& now = past_.back();
  const Eigen::Vector3d p = body_.T_ned_body.translation() + velocity_.linear_ned * beyond_s;
  Eigen::Quaterniond q = body_.T_ned_body.rotation() * so3_exp(velocity_.angular_body * beyond_s);
  if (q.w() < 0) q.coeffs() *= -1;
  const Eigen::Matrix3d R = q.toRotationMatrix();
  const Eigen::Vector3d v = R.transpose() * velocity_.linear_ned;
  const Eigen::Vector3d& omega = velocity_.angular_body;

  Odometry m;
  const std::int64_t time_ns = now.time_ns + static_cast<std::int64_t>(1e9 * beyond_s);
  m.time_usec = static_cast<std::uint64_t>(std::max<std::int64_t>(time_ns, 0) / 1000);
  m.x = static_cast<float>(p.x()), m.y = static_cast<float>(p.y()), m.z = static_cast<float>(p.z());
  m.q = {static_cast<float>(q.w()), static_cast<float>(q.x()), static_cast<float>(q.y()),
         static_cast<float>(q.z())};
  m.vx = static_cast<float>(v.x()), m.vy = static_cast<float>(v.y());
  m.vz = static_cast<float>(v.z());
  m.rollspeed = static_cast<float>(omega.x()), m.pitchspeed = static_cast<float>(omega.y());
  m.yawspeed = static_cast<float>(omega.z());

  const double growth = beyond_s * (1 + beyond_s / interval_s_) / std::sqrt(3.0);
  Matrix6d pose = body_.covariance;
  pose.topLeftCorner<3, 3>() += growth * growth * linear_changes_;
  pose.bottomRightCorner<3, 3>() += growth * growth * (R * angular_changes_ * R.transpose());
  const bool pose_known = pose.allFinite() && (pose.diagonal().array() > 0).all();
  m.pose_covariance = pose_known ? upper_triangle(pose) : unknown_covariance();

  Matrix6d twist = Matrix6d::Zero();
  const double scale_variance = now.placement->covariance(6, 6);
  twist.topLeftCorner<3, 3>() =
      R.transpose() * linear_changes_ * R / 3 + scale_variance * v * v.transpose();
  twist.bottomRightCorner<3, 3>() = angular_changes_ / 3;
  m.velocity_covariance =
      changes_ >= kLeastChanges && twist.allFinite() ? upper_triangle(twist) : unknown_covariance();
  m.frame_id = options_.frame;
  m.reset_counter = static_cast<std::uint8_t>((now.resets + replacements_) % 256);
  m.quality = now.state == TrackingState::tracking ? 100 : 30;
  return m;
}

}  // namespace corvid
