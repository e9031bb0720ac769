#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "corvid/image.h"

namespace corvid::oracle {

/// What a template looks like and how its samples are weighted.
struct NccShape {
  int width = 11, height = 11;
  std::vector<double> weights_x, weights_y;  // any sum
};

inline std::vector<double> ncc_weights_1d(int size, bool gaussian) {
  std::vector<double> w;
  for (int u = -size / 2; u <= size / 2; ++u)
    w.push_back(gaussian ? std::exp(-u * u / (2 * (size / 6.) * (size / 6.))) : 1);
  return w;
}

/// Uniform, or Gaussian of sigma = side / 6.
inline NccShape ncc_shape(int width, int height, bool gaussian) {
  return {width, height, ncc_weights_1d(width, gaussian), ncc_weights_1d(height, gaussian)};
}

/// Row-major, sum 1.
inline std::vector<double> ncc_weights(const NccShape& shape) {
  std::vector<double> w;
  double sum = 0;
  for (const double y : shape.weights_y)
    for (const double x : shape.weights_x) {
      w.push_back(x * y);
      sum += w.back();
    }
  for (double& value : w) value /= sum;
  return w;
}

/// Keys' cubic convolution kernel, a = -1/2 (Catmull-Rom).
inline double cubic(double x) {
  x = std::abs(x);
  if (x < 1) return (1.5 * x - 2.5) * x * x + 1;
  if (x < 2) return ((-0.5 * x + 2.5) * x - 4) * x + 2;
  return 0;
}

/// Bicubic reading, pixels repeated past the border.
template <class Pixel>
double bicubic(const Image<Pixel>& image, double x, double y) {
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
  double sum = 0;
  for (int j = y0 - 1; j <= y0 + 2; ++j)
    for (int i = x0 - 1; i <= x0 + 2; ++i)
      sum += cubic(x - i) * cubic(y - j) *
             image(std::clamp(i, 0, image.width() - 1), std::clamp(j, 0, image.height() - 1));
  return sum;
}

/// Sample (u, v) at centre + A (u, v), A = {a00, a01, a10, a11}.
template <class Pixel>
std::vector<double> sample_template(const Image<Pixel>& image, double x, double y,
                                    const float (&A)[4], int width, int height) {
  std::vector<double> t;
  for (int v = -height / 2; v <= height / 2; ++v)
    for (int u = -width / 2; u <= width / 2; ++u)
      t.push_back(bicubic(image, x + A[0] * u + A[1] * v, y + A[2] * u + A[3] * v));
  return t;
}

struct Moments {
  double mean = 0, variance = 0;
};
inline Moments moments(const std::vector<double>& values, const std::vector<double>& w) {
  Moments m;
  for (std::size_t i = 0; i < w.size(); ++i) m.mean += w[i] * values[i];
  for (std::size_t i = 0; i < w.size(); ++i)
    m.variance += w[i] * (values[i] - m.mean) * (values[i] - m.mean);
  return m;
}

/// C of two sets of samples; nothing if one of them has a variance below the limits given.
inline std::optional<double> correlate(const std::vector<double>& t, const std::vector<double>& s,
                                       const std::vector<double>& w, double min_variance_t,
                                       double min_variance_s) {
  const Moments mt = moments(t, w), ms = moments(s, w);
  if (mt.variance < min_variance_t || ms.variance < min_variance_s) return {};
  double product = 0;
  for (std::size_t i = 0; i < w.size(); ++i) product += w[i] * (t[i] - mt.mean) * (s[i] - ms.mean);
  return product / std::sqrt(mt.variance * ms.variance);
}

/// C with the template centred at the target's pixel (x, y); nothing if it leaves the target, or if
/// a variance is below what counts as none.
template <class Pixel>
std::optional<double> ncc_at(const std::vector<double>& t, const Image<Pixel>& target, int x, int y,
                             const NccShape& shape, const std::vector<double>& w) {
  const int half_x = shape.width / 2, half_y = shape.height / 2;
  if (x < half_x || y < half_y || x + half_x >= target.width() || y + half_y >= target.height())
    return {};
  std::vector<double> s;
  for (int v = -half_y; v <= half_y; ++v)
    for (int u = -half_x; u <= half_x; ++u) s.push_back(target(x + u, y + v));
  if constexpr (sizeof(Pixel) == 1) {
    const bool uniform = w.front() > 0.999 / static_cast<double>(w.size());
    return correlate(t, s, w, 0.01, uniform ? 1e-9 : 0.1);
  }
  const double mean = moments(s, w).mean, mean_t = moments(t, w).mean;
  return correlate(t, s, w, std::max(1e-10 * mean_t * mean_t, 1e-30),
                   std::max(1e-10 * mean * mean, 1e-30));
}

struct Peak {
  double x = 0, y = 0, score = 0, cxx = 0, cxy = 0, cyy = 0;
};

/// Least-squares quadratic of values[row][column] around (0, 0), by the normal equations; nothing
/// unless it has a maximum within a pixel.
inline std::optional<Peak> quadratic_peak(const double (&values)[3][3]) {
  // Orthogonal on the grid: 1, x, y, x^2 - 2/3, y^2 - 2/3, xy.
  double c[6] = {}, norm[6] = {};
  for (int y = -1; y <= 1; ++y)
    for (int x = -1; x <= 1; ++x) {
      const double basis[6] = {
          1, double(x), double(y), x * x - 2 / 3., y * y - 2 / 3., double(x * y)};
      for (int k = 0; k < 6; ++k) {
        c[k] += basis[k] * values[y + 1][x + 1];
        norm[k] += basis[k] * basis[k];
      }
    }
  for (int k = 0; k < 6; ++k) c[k] /= norm[k];
  Peak p;
  p.cxx = 2 * c[3];
  p.cyy = 2 * c[4];
  p.cxy = c[5];
  const double det = p.cxx * p.cyy - p.cxy * p.cxy;
  if (!(p.cxx < 0 && det > 0)) return {};
  p.x = (p.cxy * c[2] - p.cyy * c[1]) / det;
  p.y = (p.cxy * c[1] - p.cxx * c[2]) / det;
  if (std::abs(p.x) > 1 || std::abs(p.y) > 1) return {};
  p.score = std::min(1., c[0] + c[1] * p.x + c[2] * p.y + c[3] * (p.x * p.x - 2 / 3.) +
                             c[4] * (p.y * p.y - 2 / 3.) + c[5] * p.x * p.y);
  return p;
}

}  // namespace corvid::oracle
