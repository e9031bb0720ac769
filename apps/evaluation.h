#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/alignment.h"
#include "core/associate.h"
#include "corvid/pose.h"

namespace corvid {

/// What the estimate may be moved by before it is compared with the truth.
enum class AlignmentMode {
  sim3,  ///< rotation, translation and scale: a single camera's map
  se3,   ///< rotation and translation
  none,  ///< both are in one frame already
};

struct EvaluationOptions {
  AlignmentMode alignment = AlignmentMode::sim3;
  double max_time_difference_s = 0.01;  ///< as the evo tool has it
  int rpe_delta_frames = 1;             ///< relative error between pose i and pose i + delta
};

struct Statistics {
  std::size_t count = 0;  ///< all others are zero if it is
  double rmse = 0, mean = 0, median = 0, p90 = 0, max = 0;
};
/// Takes finite values.
[[nodiscard]] Statistics statistics(std::vector<double> values);

/// KITTI odometry's measure: error of the relative pose over all segments of some lengths, divided
/// by the length (Geiger et al., "Are we ready for autonomous driving?", 2012).
struct SegmentErrors {
  std::size_t segments = 0;
  std::vector<double> lengths_m;  ///< those that occur
  double t_rel_percent = 0;
  double r_rel_deg_per_100m = 0;
  /// The path is too short for the standard lengths (100, 200 ... 800 m): 10, 20 ... 80 m instead.
  bool short_segments = false;
};

struct TrajectoryErrors {
  std::string problem;  ///< why there are no errors; empty if there are
  std::vector<std::string> notes;

  std::size_t matched = 0;       ///< estimated poses with a true one
  std::size_t unmatched = 0;     ///< estimated poses without
  std::size_t interpolated = 0;  ///< of the matched
  double path_length_m = 0;      ///< of the truth, over the matched poses

  Sim3 T_truth_estimate;  ///< the alignment that was applied
  /// True metres per unit of the estimate, as Sim(3) alignment finds it in every mode; 1 if the
  /// positions do not allow it.
  double scale = 1;
  /// Scale of the last third of the poses over that of the first third, from the positions' spread;
  /// 1: no drift; above 1: the estimate shrinks. Absent with fewer than 9 poses or no motion.
  std::optional<double> scale_drift;

  Statistics position_m;       ///< absolute trajectory error, after alignment
  Statistics orientation_deg;  ///< after alignment
  /// The part of it that never changes, in the camera's frame, and the rms of the rest: no images
  /// can tell a constant rotation between the camera and the sensor that measured the truth.
  double orientation_constant_deg = 0, orientation_rest_deg = 0;
  Statistics rpe_translation_m;  ///< relative pose error per rpe_delta_frames, after alignment
  Statistics rpe_rotation_deg;
  SegmentErrors kitti;

  /// Per matched pose, in order of time, for plots: the aligned estimate, the truth, the errors.
  std::vector<PosePair> poses;
  std::vector<double> position_errors_m, orientation_errors_deg;
};

/// Compares a trajectory with the truth. Never NaN: where nothing can be said, `problem` is set and
/// the numbers are zero.
[[nodiscard]] TrajectoryErrors evaluate(const Trajectory& estimate, const Trajectory& truth,
                                        const EvaluationOptions& options = {});

}  // namespace corvid
