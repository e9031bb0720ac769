#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "corvid/mesh_stream.h"
#include "corvid/pose.h"

namespace corvid {

struct SurfaceOptions {
  std::size_t estimate_samples = 200000;  ///< spread over the estimated surface by area
  std::size_t truth_samples = 500000;     ///< spread over the true surface by area
  std::vector<double> completeness_distances_m{0.05, 0.1, 0.2, 0.5, 1.0};
  /// If set: the true points that count for completeness (those that a camera saw).
  std::function<bool(const Eigen::Vector3d&)> seen;
};

struct SurfaceErrors {
  std::string problem;  ///< why there are no errors; empty if there are
  std::size_t estimate_samples = 0, truth_samples = 0;  ///< that were compared
  double estimate_area_m2 = 0, truth_area_m2 = 0;
  /// Distance of the estimated surface to the true one.
  double median_m = 0, mean_m = 0, rmse_m = 0;
  double accuracy90_m = 0;  ///< nine tenths of the estimated surface are at least as near
  /// Share of the true surface within each of these distances of the estimated one.
  std::vector<double> completeness_distances_m, completeness;
};

/// Points spread evenly over a mesh by area, the same for the same mesh; none if it has no area.
/// Broken triangles (triangle_tree.h) are passed over.
struct SurfaceSamples {
  std::vector<Eigen::Vector3d> points;
  double area = 0;
};
[[nodiscard]] SurfaceSamples sample_surface(const TriangleMesh& mesh, std::size_t samples);

/// Compares two surfaces after the estimate has been moved by `T_truth_estimate`.
///
/// Samples of each surface are measured to the nearest point of the other (exact, by a tree of
/// triangles). Deterministic. Never NaN.
[[nodiscard]] SurfaceErrors compare_surfaces(const TriangleMesh& estimate,
                                             const TriangleMesh& truth,
                                             const Sim3& T_truth_estimate,
                                             const SurfaceOptions& options = {});

}  // namespace corvid
