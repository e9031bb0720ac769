#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "corvid/error.h"
#include "corvid/pose.h"

namespace corvid {

enum class TrajectoryFormat { tum, kitti, euroc };

struct TrajectoryReadOptions {
  std::optional<TrajectoryFormat> format;  ///< empty: recognised by the columns
  /// KITTI rows have no times. One time in seconds per row of this file; if empty, times.txt beside
  /// the poses or ../sequences/NN/times.txt for poses/NN.txt, where it has at least as many rows;
  /// otherwise row i is at i / rate_hz.
  std::string times_path;
  double rate_hz = 10;  ///< of KITTI rows without times
};

/// What a file begins with that is appended to line by line while a run goes on: a last line
/// without its end is not whole, and readers leave it out.
inline constexpr std::string_view kAppended = "# appended line by line";

/// Reads poses as `T_world_camera` in the order of time:
///   TUM    `time tx ty tz qx qy qz qw`, time in seconds, blanks or commas between;
///   KITTI  12 numbers, the upper 3x4 of the pose matrix, row by row;
///   EuRoC  `time_ns, px, py, pz, qw, qx, qy, qz, ...`: the body's pose, as it stands in the file.
/// Errors: not_found, io, corrupt (path:line; non-finite numbers, wrong column counts, quaternions
/// that are zero, times that repeat or go back).
[[nodiscard]] Expected<Trajectory> read_trajectory(const std::string& path,
                                                   const TrajectoryReadOptions& options = {});

/// One line of the TUM format as write_trajectory() writes it.
void append_tum_line(std::string& text, const StampedPose& stamped);

/// Writes TUM format atomically: seconds with nine decimals, exact to the nanosecond; poses with 17
/// significant digits.
[[nodiscard]] Expected<void> write_trajectory(const std::string& path,
                                              const Trajectory& trajectory);

}  // namespace corvid
