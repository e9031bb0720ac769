#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "corvid/pose.h"

namespace corvid {

/// An estimated pose and the true one at its time.
struct PosePair {
  std::size_t estimate_index = 0;
  std::int64_t time_ns = 0;  ///< of the estimate
  Pose estimate, truth;
  bool interpolated = false;  ///< truth lies between two of the truth's poses
};

/// Pairs by time. An estimate whose time lies between two true poses that are both within the
/// largest difference gets the truth interpolated (linear position, slerp); otherwise it gets the
/// nearest true pose within that difference, each true pose at most once. Both ordered by time.
[[nodiscard]] std::vector<PosePair> associate(const Trajectory& estimate, const Trajectory& truth,
                                              double max_time_difference_s = 0.01);

/// The true pose at each of the times, ascending; nothing where there is none or it is not finite.
[[nodiscard]] std::vector<std::optional<Pose>> true_poses(std::span<const std::int64_t> times_ns,
                                                          const Trajectory& truth);

}  // namespace corvid
