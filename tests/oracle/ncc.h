#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "corvid/image.h"

namespace corvid::oracle {

/// Weights of a size x size template, row-major, sum 1: uniform, or Gaussian of sigma = size / 6.
inline std::vector<double> ncc_weights(int size, bool gaussian) {
  std::vector<double> w;
  double sum = 0;
  for (int v = -size / 2; v <= size / 2; ++v)
    for (int u = -size / 2; u <= size / 2; ++u) {
      const double sigma = size / 6.;
      w.push_back(gaussian ? std::exp(-(u * u + v * v) / (2 * sigma * sigma)) : 1);
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
inline double bicubic(const GreyImage& image, double x, double y) {
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
  double sum = 0;
  for (int j = y0 - 1; j <= y0 + 2; ++j)
    for (int i = x0 - 1; i <= x0 + 2; ++i)
      sum += cubic(x - i) * cubic(y - j) *
             image(std::clamp(i, 0, image.width() - 1), std::clamp(j, 0, image.height() - 1));
  return sum;
}

/// size x size samples, sample (u, v) at centre + A (u, v), A = {a00, a01, a10, a11}.
inline std::vector<double> sample_template(const GreyImage& image, double x, double y,
                                           const float (&A)[4], int size) {
  std::vector<double> t;
  for (int v = -size / 2; v <= size / 2; ++v)
    for (int u = -size / 2; u <= size / 2; ++u)
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

/// C with the template centred at the target's pixel (x, y); nothing if it leaves the target.
inline std::optional<double> ncc_at(const std::vector<double>& t, const GreyImage& target, int x,
                                    int y, int size, bool gaussian) {
  const int half = size / 2;
  if (x < half || y < half || x + half >= target.width() || y + half >= target.height()) return {};
  constexpr float kIdentity[4] = {1, 0, 0, 1};
  const auto w = ncc_weights(size, gaussian);
  return correlate(t, sample_template(target, x, y, kIdentity, size), w, 0.01,
                   gaussian ? 0.1 : 1e-9);
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
