#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include "corvid/camera.h"
#include "corvid/image.h"
#include "corvid/pose.h"

// Depth of one ray by multi-view NCC, from the equations (algorithms.md 2 and 7), in double
// precision and without any sharing of work.
namespace corvid::oracle {

struct DepthView {
  const Image<double>* image = nullptr;
  Camera camera;
  Pose T_neighbour_reference;
};

struct DepthSettings {
  int template_px = 11;
  double min_score = 0.6, min_variance = 2;
  int min_views = 2;
  double near = 1, far = 10;
  int samples = 96;
};

struct FusedSample {
  double score = 0;  ///< mean of the scores above min_score if valid, else of all positive ones
  bool valid = false;
};

/// Rounded to whole grey levels.
inline Image<double> mean_of_blocks(const GreyImage& image, int scale) {
  Image<double> out(image.width() / scale, image.height() / scale);
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      for (int i = 0; i < scale * scale; ++i) {
        out(x, y) += image(x * scale + i % scale, y * scale + i / scale) / double(scale * scale);
      }
      out(x, y) = std::floor(out(x, y) + 0.5);
    }
  }
  return out;
}

/// NaN outside.
inline double bilinear(const Image<double>& image, double x, double y) {
  if (!image.contains(x, y)) return std::numeric_limits<double>::quiet_NaN();
  const int x0 = std::min(int(x), image.width() - 2), y0 = std::min(int(y), image.height() - 2);
  const double fx = x - x0, fy = y - y0;
  return (1 - fy) * ((1 - fx) * image(x0, y0) + fx * image(x0 + 1, y0)) +
         fy * ((1 - fx) * image(x0, y0 + 1) + fx * image(x0 + 1, y0 + 1));
}

/// Weighted NCC of the template round (x, y) with what `view` sees of the plane z = 1 / inverse.
/// NaN if a window leaves its image or has no texture.
inline double plane_score(const Image<double>& reference, const Camera& camera,
                          const DepthView& view, int x, int y, double inverse,
                          const DepthSettings& s) {
  const int radius = s.template_px / 2;
  const double sigma = s.template_px / 6.0;
  const Eigen::Matrix3d K_inverse = camera.K().inverse();
  double sw = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, s5 = 0;
  for (int j = -radius; j <= radius; ++j) {
    for (int i = -radius; i <= radius; ++i) {
      if (!reference.contains(x + i, y + j)) return std::numeric_limits<double>::quiet_NaN();
      const double w = std::exp(-0.5 * (i * i + j * j) / (sigma * sigma));
      const double r = reference(x + i, y + j);
      const Eigen::Vector3d p = K_inverse * Eigen::Vector3d(x + i, y + j, 1) / inverse;
      const Eigen::Vector3d q = view.camera.K() * (view.T_neighbour_reference * p);
      if (!(q.z() > 0)) return std::numeric_limits<double>::quiet_NaN();
      const double t = bilinear(*view.image, q.x() / q.z(), q.y() / q.z());
      sw += w, s1 += w * r * r, s2 += w * r, s3 += w * r * t, s4 += w * t, s5 += w * t * t;
    }
  }
  s1 /= sw, s2 /= sw, s3 /= sw, s4 /= sw, s5 /= sw;
  const double var_r = s1 - s2 * s2, var_t = s5 - s4 * s4;
  if (!(var_r > s.min_variance && var_t > s.min_variance)) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  return (s3 - s2 * s4) / std::sqrt(var_r * var_t);
}

/// The fused score along one ray, sample i at inverse depth 1/far + i (1/near - 1/far)/(n - 1).
inline std::vector<FusedSample> ray_scores(const Image<double>& reference, const Camera& camera,
                                           std::span<const DepthView> views, int x, int y,
                                           const DepthSettings& s) {
  std::vector<FusedSample> out;
  for (int i = 0; i < s.samples; ++i) {
    const double inverse = 1 / s.far + i * (1 / s.near - 1 / s.far) / (s.samples - 1);
    double sum_valid = 0, sum_seen = 0;
    int valid = 0, seen = 0;
    for (const DepthView& view : views) {
      const double score = plane_score(reference, camera, view, x, y, inverse, s);
      if (std::isnan(score)) continue;
      ++seen;
      sum_seen += std::max(score, 0.0);
      if (score > s.min_score) {
        ++valid;
        sum_valid += score;
      }
    }
    FusedSample sample;
    sample.valid = valid >= s.min_views;
    sample.score = sample.valid ? sum_valid / valid : seen > 0 ? sum_seen / seen : 0;
    out.push_back(sample);
  }
  return out;
}

struct RayAnswer {
  double inverse = 0;  ///< 0: no answer
  double score = 0;
  /// By how much the decisions that led here were taken: best peak over the next, best peak over
  /// the interval's ends, valid over invalid.
  double margin = std::numeric_limits<double>::infinity();
};

/// The best valid interior peak, refined by a parabola.
inline RayAnswer best_peak(const std::vector<FusedSample>& f, const DepthSettings& s) {
  RayAnswer out;
  int best = -1;
  const int n = int(f.size());
  for (int i = 1; i + 1 < n; ++i) {
    if (!f[i].valid || f[i].score < f[i - 1].score || f[i].score <= f[i + 1].score) continue;
    if (best >= 0) out.margin = std::min(out.margin, std::abs(f[i].score - f[best].score));
    if (best < 0 || f[i].score > f[best].score) best = i;
  }
  if (best < 0) return out;
  for (const int end : {0, n - 1}) {
    if (!f[end].valid) continue;
    out.margin = std::min(out.margin, std::abs(f[end].score - f[best].score));
    if (f[end].score > f[best].score) return out;
  }
  const double p = f[best - 1].score, c = f[best].score, q = f[best + 1].score;
  const double offset = 0.5 * (p - q) / (p - 2 * c + q);
  out.inverse = 1 / s.far + (best + offset) * (1 / s.near - 1 / s.far) / (s.samples - 1);
  out.score = c - 0.25 * (p - q) * offset;
  return out;
}

}  // namespace corvid::oracle
