#include "apps/evaluation.h"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

namespace corvid {
namespace {

constexpr double kDegPerRad = 180 / std::numbers::pi;

double angle_deg(const Eigen::Quaterniond& q) { return so3_log(q).norm() * kDegPerRad; }

/// Path length up to each pose.
std::vector<double> distances(const std::vector<PosePair>& poses) {
  std::vector<double> out(poses.size(), 0.0);
  for (std::size_t i = 1; i < poses.size(); ++i) {
    out[i] = out[i - 1] + (poses[i].truth.translation() - poses[i - 1].truth.translation()).norm();
  }
  return out;
}

/// The true motion from pose i to pose j, undone by the estimated one.
Pose relative_error(const PosePair& i, const PosePair& j) {
  return (i.truth.inverse() * j.truth).inverse() * (i.estimate.inverse() * j.estimate);
}

double spread(const std::vector<Eigen::Vector3d>& points, std::size_t first, std::size_t last) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::size_t i = first; i < last; ++i) mean += points[i];
  mean /= static_cast<double>(last - first);
  double squares = 0;
  for (std::size_t i = first; i < last; ++i) squares += (points[i] - mean).squaredNorm();
  return std::sqrt(squares / static_cast<double>(last - first));
}

std::optional<double> scale_drift(const std::vector<Eigen::Vector3d>& estimate,
                                  const std::vector<Eigen::Vector3d>& truth) {
  const std::size_t n = estimate.size(), third = n / 3;
  if (third < 3) return std::nullopt;
  const double first_true = spread(truth, 0, third), first = spread(estimate, 0, third);
  const double last_true = spread(truth, n - third, n), last = spread(estimate, n - third, n);
  // A spread that is nothing beside the whole path is standing still, and says nothing of scale.
  const double still_true = 1e-6 * spread(truth, 0, n), still = 1e-6 * spread(estimate, 0, n);
  if (!(std::min(first_true, last_true) > still_true) || !(std::min(first, last) > still)) {
    return std::nullopt;
  }
  return (last_true / last) / (first_true / first);
}

void add_relative_errors(int delta_frames, TrajectoryErrors& out) {
  const auto& poses = out.poses;
  const std::size_t delta = static_cast<std::size_t>(std::max(1, delta_frames));
  if (poses.size() <= delta) return;
  // Pairs that span a gap in the estimate are not "per delta": they are left out.
  std::vector<std::int64_t> steps_ns;
  for (std::size_t i = 0; i + delta < poses.size(); ++i) {
    steps_ns.push_back(poses[i + delta].time_ns - poses[i].time_ns);
  }
  std::vector<std::int64_t> sorted = steps_ns;
  std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2),
                   sorted.end());
  const double longest_ns = 1.5 * static_cast<double>(sorted[sorted.size() / 2]);
  std::vector<double> translation_m, rotation_deg;
  for (std::size_t i = 0; i < steps_ns.size(); ++i) {
    if (static_cast<double>(steps_ns[i]) > longest_ns) continue;
    const Pose error = relative_error(poses[i], poses[i + delta]);
    translation_m.push_back(error.translation().norm());
    rotation_deg.push_back(angle_deg(error.rotation()));
  }
  if (translation_m.size() < steps_ns.size()) {
    out.notes.push_back(fmt::format("{} of {} relative errors left out: they span gaps in time",
                                    steps_ns.size() - translation_m.size(), steps_ns.size()));
  }
  out.rpe_translation_m = statistics(std::move(translation_m));
  out.rpe_rotation_deg = statistics(std::move(rotation_deg));
}

SegmentErrors segment_errors(const std::vector<PosePair>& poses,
                             const std::vector<double>& distance_m, double unit_m,
                             std::size_t step) {
  SegmentErrors out;
  double t_sum = 0, r_sum = 0;
  for (int k = 1; k <= 8; ++k) {
    const double length_m = k * unit_m;
    bool occurs = false;
    for (std::size_t first = 0; first < poses.size(); first += step) {
      const auto end = std::upper_bound(distance_m.begin() + static_cast<std::ptrdiff_t>(first),
                                        distance_m.end(), distance_m[first] + length_m);
      if (end == distance_m.end()) break;
      const auto last = static_cast<std::size_t>(end - distance_m.begin());
      const Pose error = relative_error(poses[first], poses[last]);
      t_sum += error.translation().norm() / length_m;
      r_sum += angle_deg(error.rotation()) / length_m;
      ++out.segments;
      occurs = true;
    }
    if (occurs) out.lengths_m.push_back(length_m);
  }
  if (out.segments > 0) {
    out.t_rel_percent = 100 * t_sum / static_cast<double>(out.segments);
    out.r_rel_deg_per_100m = 100 * r_sum / static_cast<double>(out.segments);
  }
  return out;
}

void add_segment_errors(TrajectoryErrors& out) {
  const std::vector<double> distance_m = distances(out.poses);
  out.path_length_m = distance_m.back();
  out.kitti = segment_errors(out.poses, distance_m, 100, 10);  // KITTI starts at every tenth frame
  if (out.kitti.segments > 0) return;
  out.kitti = segment_errors(out.poses, distance_m, 10, 1);
  out.kitti.short_segments = out.kitti.segments > 0;
  out.notes.push_back(
      out.kitti.short_segments
          ? fmt::format("the path of {:.1f} m is too short for segments of 100 to 800 m: t_rel and "
                        "r_rel are over 10 to 80 m",
                        out.path_length_m)
          : fmt::format("the path of {:.1f} m is too short for t_rel and r_rel",
                        out.path_length_m));
}

/// A rotation between the two camera frames that never changes is a matter of definitions (the
/// truth is often of an IMU); a large one is worth a note, since it swamps the orientation error.
void split_orientation(TrajectoryErrors& out) {
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();  // its first eigenvector is the mean rotation
  for (const PosePair& p : out.poses) {
    const Eigen::Vector4d q = (p.estimate.rotation().conjugate() * p.truth.rotation()).coeffs();
    sum += q * q.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(sum);
  const Eigen::Quaterniond mean(Eigen::Vector4d(eigen.eigenvectors().col(3)));
  double squares = 0;
  for (const PosePair& p : out.poses) {
    const double a = angle_deg((p.estimate.rotation() * mean).conjugate() * p.truth.rotation());
    squares += a * a;
  }
  out.orientation_constant_deg = angle_deg(mean);
  out.orientation_rest_deg = std::sqrt(squares / static_cast<double>(out.poses.size()));
  if (out.orientation_deg.rmse < 5 || out.orientation_rest_deg > 0.25 * out.orientation_deg.rmse)
    return;
  out.notes.push_back(
      fmt::format("the orientations differ by a constant {:.1f} deg (without it {:.2f} deg rmse): "
                  "the truth is probably of another body frame than the camera's",
                  out.orientation_constant_deg, out.orientation_rest_deg));
}

}  // namespace

Statistics statistics(std::vector<double> values) {
  Statistics s;
  s.count = values.size();
  if (values.empty()) return s;
  std::sort(values.begin(), values.end());
  const auto n = static_cast<double>(values.size());
  s.mean = std::accumulate(values.begin(), values.end(), 0.0) / n;
  s.rmse = std::sqrt(std::inner_product(values.begin(), values.end(), values.begin(), 0.0) / n);
  const std::size_t half = values.size() / 2;
  s.median = values.size() % 2 == 1 ? values[half] : 0.5 * (values[half - 1] + values[half]);
  s.p90 = values[static_cast<std::size_t>(std::ceil(0.9 * n)) - 1];  // nearest rank
  s.max = values.back();
  return s;
}

TrajectoryErrors evaluate(const Trajectory& estimate, const Trajectory& truth,
                          const EvaluationOptions& options) {
  TrajectoryErrors out;
  std::vector<PosePair> pairs = associate(estimate, truth, options.max_time_difference_s);
  std::erase_if(pairs, [](const PosePair& p) { return !p.estimate.finite() || !p.truth.finite(); });
  out.matched = pairs.size();
  out.unmatched = estimate.size() - pairs.size();
  out.interpolated = static_cast<std::size_t>(
      std::count_if(pairs.begin(), pairs.end(), [](const PosePair& p) { return p.interpolated; }));
  if (pairs.empty()) {
    out.problem = estimate.empty() ? "the estimate has no poses"
                  : truth.empty()
                      ? "the truth has no poses"
                      : fmt::format(
                            "no estimated pose lies within {} s of a true one: are both on "
                            "the same clock?",
                            options.max_time_difference_s);
    return out;
  }

  std::vector<Eigen::Vector3d> from, to;
  for (const PosePair& p : pairs) {
    from.push_back(p.estimate.translation());
    to.push_back(p.truth.translation());
  }
  const PointAlignment similarity = align_points(from, to, true);
  if (similarity.ok()) out.scale = similarity.T_target_source.scale();
  if (options.alignment != AlignmentMode::none) {
    const PointAlignment alignment =
        options.alignment == AlignmentMode::sim3 ? similarity : align_points(from, to, false);
    if (!alignment.ok()) {
      out.problem =
          fmt::format("the trajectories cannot be aligned: {}", to_string(alignment.status));
      return out;
    }
    out.T_truth_estimate = alignment.T_target_source;
  }
  out.scale_drift = scale_drift(from, to);

  for (PosePair& p : pairs) {
    p.estimate = out.T_truth_estimate * p.estimate;
    out.position_errors_m.push_back((p.estimate.translation() - p.truth.translation()).norm());
    out.orientation_errors_deg.push_back(
        angle_deg(p.estimate.rotation().conjugate() * p.truth.rotation()));
  }
  out.poses = std::move(pairs);
  out.position_m = statistics(out.position_errors_m);
  out.orientation_deg = statistics(out.orientation_errors_deg);
  split_orientation(out);
  add_relative_errors(options.rpe_delta_frames, out);
  add_segment_errors(out);
  return out;
}

}  // namespace corvid
