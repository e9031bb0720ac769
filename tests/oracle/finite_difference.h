#pragma once

#include <Eigen/Core>
#include <random>

namespace corvid::test {

/// Central differences of f: R^N -> R^M at x; the error is of order step^2.
template <int M, int N, class F>
Eigen::Matrix<double, M, N> finite_difference(const F& f, const Eigen::Matrix<double, N, 1>& x,
                                              double step = 1e-6) {
  Eigen::Matrix<double, M, N> J;
  for (int i = 0; i < N; ++i) {
    Eigen::Matrix<double, N, 1> plus = x, minus = x;
    plus[i] += step;
    minus[i] -= step;
    J.col(i) = (f(plus) - f(minus)) / (2 * step);
  }
  return J;
}

/// Uniform in [-size, size] per component.
template <int N>
Eigen::Matrix<double, N, 1> random_vector(std::mt19937& rng, double size) {
  std::uniform_real_distribution<double> uniform(-size, size);
  Eigen::Matrix<double, N, 1> v;
  for (int i = 0; i < N; ++i) v[i] = uniform(rng);
  return v;
}

/// Rotation vector of the given length in a random direction.
inline Eigen::Vector3d random_rotation(std::mt19937& rng, double angle_rad) {
  Eigen::Vector3d v;
  do v = random_vector<3>(rng, 1);
  while (v.norm() < 0.1);
  return angle_rad * v.normalized();
}

}  // namespace corvid::test
