#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>

#include "corvid/map.h"
#include "io/mavlink/body_pose.h"
#include "io/mavlink/messages.h"

namespace corvid {

struct OdometryOptions {
  /// Where the camera's poses come less often, extrapolated ones fill the gaps; 0: none do.
  double rate_hz = 30;
  /// How the frame north, east, down is called. ArduPilot listens to local_frd only, which PX4
  /// turns by how its attitude differs from ours unless it takes the yaw, too; to PX4 local_ned is
  /// the same as its own.
  mavlink::Frame frame = mavlink::Frame::local_frd;
  Pose T_body_camera{camera_mount(0, 0, 0), Eigen::Vector3d::Zero()};  ///< [m]
};

/// What became of pose events; those without a pose or without metric scale are not counted.
struct OdometryCounts {
  std::uint64_t measured = 0;      ///< poses that went out
  std::uint64_t extrapolated = 0;  ///< messages between them
  std::uint64_t late = 0;          ///< poses that an extrapolation had overtaken
  std::uint64_t stale = 0;         ///< more than a second old, or of another clock
};

/// Makes ODOMETRY messages of pose events. Knows no time but what it is given; one owner.
///
/// Nothing leaves it before the map's scale is metric, while there is no pose, or before two poses
/// of one reset count have given a velocity (autopilots take the velocity as it is, NaN included).
///
/// Between the measured poses v is constant on Earth and omega in the body. How wrong that is tells
/// the change of the velocity from pose to pose, v - v', whose second moment C follows the flight:
/// noise of the poses (variance n per axis) makes it 6 n / dt^2, an acceleration a makes it
/// a^2 dt^2. The velocity itself is wrong by 2 n / dt^2 and by a^2 dt^2 / 4, so C / 3 bounds both;
/// the position after tau by 2 n tau^2 / dt^2 and by (a tau (tau + dt) / 2)^2, which
/// C g^2 with g = tau (1 + tau / dt) / sqrt(3) bounds. The same for rotations.
///
/// An extrapolation has the age of the pose it follows, not that of the moment of sending: so times
/// rise from message to message, and every measured pose goes out, too.
class OdometryStream {
 public:
  static constexpr double kMostBeyond_s = 0.25;  ///< after the last pose; older helps no autopilot
  static constexpr double kMostAge_s = 1;        ///< of a pose when it arrives
  static constexpr double kMostGap_s = 1;        ///< between poses that make a velocity
  static constexpr double kLeastGap_s = 2e-3;    ///< nearer ones' noise would make a wild velocity
  static constexpr int kLeastChanges = 5;        ///< of velocity, for its covariance to be known

  explicit OdometryStream(const OdometryOptions& options) : options_(options) {}

  /// @param arrival_ns  now, in the clock of the events' times.
  /// @return the message of this pose, if it is to be sent.
  [[nodiscard]] std::optional<mavlink::Odometry> add(const PoseEvent& event,
                                                     std::int64_t arrival_ns);
  /// When extrapolate() has something to say, unless another pose comes first.
  [[nodiscard]] std::optional<std::int64_t> due_ns() const;
  /// The newest extrapolation that is due.
  [[nodiscard]] std::optional<mavlink::Odometry> extrapolate(std::int64_t now_ns);
  [[nodiscard]] const OdometryCounts& counts() const { return counts_; }

 private:
  struct Measured {
    std::int64_t time_ns = 0, arrival_ns = 0;
    Pose T_world_camera;
    Matrix6d covariance;
    TrackingState state = TrackingState::tracking;
    std::uint64_t resets = 0;
    std::shared_ptr<const MapPlacement> placement;
  };
  /// Between two poses: linear on Earth [m/s], angular in the body [rad/s].
  struct Velocity {
    Eigen::Vector3d linear_ned, angular_body;
  };

  [[nodiscard]] Pose body_of(const Measured& m) const;
  [[nodiscard]] Velocity velocity(const Measured& older, const Measured& newer) const;
  void count_replacement(const Measured& now);
  void learn(const Velocity& before);
  void plan(double interval_s);
  [[nodiscard]] double offset_s(int step) const;
  [[nodiscard]] std::int64_t stamp_ns(int step) const;
  [[nodiscard]] mavlink::Odometry message(double beyond_s) const;

  OdometryOptions options_;
  std::deque<Measured> past_;  // at most three, of one reset count, in the order of time
  BodyPose body_;              // of the newest
  Velocity velocity_;          // at the newest
  double interval_s_ = 0;      // between the newest two
  // Second moments of the velocity's changes, on Earth [(m/s)^2] and in the body [(rad/s)^2].
  Eigen::Matrix3d linear_changes_ = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d angular_changes_ = Eigen::Matrix3d::Zero();
  int changes_ = 0;
  double spacing_s_ = 0;  // of the extrapolations
  int between_ = 0;       // the first of them for which a measured pose would be late
  int step_ = 0;          // the next of them; 0: there are none
  std::int64_t last_sent_ns_ = INT64_MIN;
  std::uint64_t replacements_ = 0;  // jumps because the map was placed elsewhere on Earth
  OdometryCounts counts_;
};

}  // namespace corvid
