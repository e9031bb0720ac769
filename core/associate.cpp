#include "core/associate.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace corvid {
namespace {

Pose interpolate(const StampedPose& a, const StampedPose& b, std::int64_t time_ns) {
  const double u =
      static_cast<double>(time_ns - a.time_ns) / static_cast<double>(b.time_ns - a.time_ns);
  const Pose& A = a.T_world_camera;
  const Pose& B = b.T_world_camera;
  return {A.rotation().slerp(u, B.rotation()), (1 - u) * A.translation() + u * B.translation()};
}

}  // namespace

std::vector<PosePair> associate(const Trajectory& estimate, const Trajectory& truth,
                                double max_time_difference_s) {
  std::vector<PosePair> pairs;
  constexpr double kLongest_s = 4e9;  // over a century; nanoseconds still fit into 63 bits
  const auto max_ns =
      static_cast<std::int64_t>(std::llround(std::min(max_time_difference_s, kLongest_s) * 1e9));
  constexpr std::size_t kNone = static_cast<std::size_t>(-1);
  std::size_t last_used = kNone;  // the true pose of the last pair, if it was not interpolated
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    const std::int64_t time_ns = estimate[i].time_ns;
    const auto after =
        std::lower_bound(truth.begin(), truth.end(), time_ns,
                         [](const StampedPose& p, std::int64_t t) { return p.time_ns < t; });
    const auto reach = [&](auto it) { return std::abs(it->time_ns - time_ns); };
    const bool has_after = after != truth.end() && reach(after) <= max_ns;
    const bool has_before = after != truth.begin() && reach(after - 1) <= max_ns;
    if (!has_after && !has_before) continue;
    PosePair pair{i, time_ns, estimate[i].T_world_camera, {}, false};
    if (has_after && has_before && after->time_ns != time_ns) {
      pair.truth = interpolate(*(after - 1), *after, time_ns);
      pair.interpolated = true;
      last_used = kNone;
    } else {
      const auto nearest = has_after ? after : after - 1;
      pair.truth = nearest->T_world_camera;
      const auto index = static_cast<std::size_t>(nearest - truth.begin());
      if (index == last_used) {
        if (reach(nearest) >= std::abs(nearest->time_ns - pairs.back().time_ns)) continue;
        pairs.pop_back();
      }
      last_used = index;
    }
    pairs.push_back(pair);
  }
  return pairs;
}

std::vector<std::optional<Pose>> true_poses(std::span<const std::int64_t> times_ns,
                                            const Trajectory& truth) {
  Trajectory stamps;
  for (const std::int64_t time_ns : times_ns) stamps.push_back({time_ns, Pose()});
  std::vector<std::optional<Pose>> poses(stamps.size());
  for (const PosePair& pair : associate(stamps, truth)) {
    if (pair.truth.finite()) poses[pair.estimate_index] = pair.truth;
  }
  return poses;
}

}  // namespace corvid
