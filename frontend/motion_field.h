#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <memory>
#include <span>
#include <utility>
#include <vector>

namespace corvid {

/// Where the neighbourhood of a point went, and how it was deformed.
struct LocalMotion {
  Eigen::Vector2d x_t = Eigen::Vector2d::Zero();         ///< [px]
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();  ///< reference offsets to target offsets
  double spread_px = 0;                                  ///< median misfit of the neighbours
  double distance_px = 0;                                ///< to the nearest neighbour
};

/// A sparse displacement field between two images, from matches.
class MotionField {
 public:
  /// @param from, to  N matched pixels, N >= 1.
  /// @param prior  linear part that an affinity is drawn to where the neighbours do not fix it.
  MotionField(std::span<const Eigen::Vector2d> from, std::span<const Eigen::Vector2d> to,
              const Eigen::Matrix2d& prior);
  ~MotionField();
  MotionField(MotionField&&) noexcept;
  MotionField& operator=(MotionField&&) noexcept;

  /// Affinity of the `neighbours` matches nearest to x, by iteratively re-weighted least squares
  /// (Cauchy weights, and falling with the distance).
  [[nodiscard]] LocalMotion at(const Eigen::Vector2d& x, std::size_t neighbours = 12) const;
  /// at() for many places, on all cores.
  [[nodiscard]] std::vector<LocalMotion> at(std::span<const Eigen::Vector2d> x,
                                            std::size_t neighbours = 12) const;

  /// How far along `direction` (unit) the neighbours would put x, from where at() puts it: the
  /// least and the largest [px]. Neighbours of other depths lie apart along the epipolar line.
  [[nodiscard]] std::pair<double, double> range_along(const Eigen::Vector2d& x,
                                                      const LocalMotion& motion,
                                                      const Eigen::Vector2d& direction,
                                                      std::size_t neighbours = 24) const;

  /// Of each match, how many of its 8 nearest others moved alike: their displacement differs from
  /// its own, but for the prior's linear part, by less than share * distance + slack_px.
  [[nodiscard]] std::vector<int> agreement(double share, double slack_px) const;

 private:
  struct Index;
  Eigen::Matrix2d prior_;
  std::unique_ptr<const Index> index_;
};

}  // namespace corvid
