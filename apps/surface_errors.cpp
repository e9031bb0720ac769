#include "apps/surface_errors.h"

#include <Eigen/Geometry>
#include <cmath>

#include "apps/evaluation.h"
#include "apps/triangle_tree.h"

namespace corvid {
SurfaceSamples sample_surface(const TriangleMesh& mesh, std::size_t samples) {
  SurfaceSamples out;
  std::vector<double> area_up_to(mesh.triangles.size());
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
    if (const auto c = triangle_corners(mesh, i)) {
      out.area += 0.5 * ((*c)[1] - (*c)[0]).cross((*c)[2] - (*c)[0]).norm();
    }
    area_up_to[i] = out.area;
  }
  if (!(out.area > 0)) return out;
  out.points.reserve(samples);
  // Even steps along the summed area choose the triangle; inside it the points follow the R2
  // sequence (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
  constexpr double kPlastic = 1.3247179572447460;
  std::size_t triangle = 0;
  for (std::size_t k = 0; k < samples; ++k) {
    const double at = (static_cast<double>(k) + 0.5) / static_cast<double>(samples) * out.area;
    while (area_up_to[triangle] < at) ++triangle;
    double whole;
    double s = std::modf(0.5 + static_cast<double>(k) / kPlastic, &whole);
    double t = std::modf(0.5 + static_cast<double>(k) / (kPlastic * kPlastic), &whole);
    if (s + t > 1) {
      s = 1 - s;
      t = 1 - t;
    }
    const TriangleCorners c = *triangle_corners(mesh, triangle);
    out.points.push_back(c[0] + s * (c[1] - c[0]) + t * (c[2] - c[0]));
  }
  return out;
}

SurfaceErrors compare_surfaces(const TriangleMesh& estimate, const TriangleMesh& truth,
                               const Sim3& T_truth_estimate, const SurfaceOptions& options) {
  SurfaceErrors out;
  out.completeness_distances_m = options.completeness_distances_m;
  out.completeness.assign(options.completeness_distances_m.size(), 0.0);
  TriangleMesh moved = estimate;
  for (auto& v : moved.vertices) v = (T_truth_estimate * v.cast<double>()).cast<float>();
  const SurfaceSamples ours = sample_surface(moved, options.estimate_samples);
  const SurfaceSamples theirs = sample_surface(truth, options.truth_samples);
  out.estimate_area_m2 = ours.area;
  out.truth_area_m2 = theirs.area;
  if (ours.points.empty() || theirs.points.empty()) {
    out.problem =
        ours.points.empty() ? "the estimated mesh has no surface" : "the true mesh has no surface";
    return out;
  }

  const TriangleTree true_surface(truth), our_surface(moved);
  std::vector<double> distances_m;
  distances_m.reserve(ours.points.size());
  for (const auto& p : ours.points) distances_m.push_back(true_surface.distance(p));
  const Statistics s = statistics(std::move(distances_m));
  out.estimate_samples = s.count;
  out.median_m = s.median;
  out.mean_m = s.mean;
  out.rmse_m = s.rmse;
  out.accuracy90_m = s.p90;

  for (const auto& p : theirs.points) {
    if (options.seen && !options.seen(p)) continue;
    ++out.truth_samples;
    const double distance_m = our_surface.distance(p);
    for (std::size_t i = 0; i < out.completeness.size(); ++i) {
      out.completeness[i] += distance_m <= options.completeness_distances_m[i];
    }
  }
  for (double& share : out.completeness) {
    if (out.truth_samples > 0) share /= static_cast<double>(out.truth_samples);
  }
  return out;
}

}  // namespace corvid
