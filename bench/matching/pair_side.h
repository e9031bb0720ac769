#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "bench/timing.h"
#include "corvid/frame.h"

namespace corvid {

/// Two points that one of the sides says are the same.
struct Correspondence {
  /// Names of the points, each unique in its image: equal names are one measurement.
  int point_r = 0, point_t = 0;
  Eigen::Vector2d x_r = Eigen::Vector2d::Zero(), x_t = x_r;  ///< [px, distorted]
};

/// What one side made of two images.
struct MatchedPair {
  int reference = 0, target = 0;  ///< positions in the run of images
  std::vector<Correspondence> matches;
  double ms = 0;  ///< both images prepared and matched: what these two alone would have taken
};

/// One of the ways of matching that `corvid bench matching` compares.
class PairSide {
 public:
  virtual ~PairSide() = default;
  /// A new run of images that overlap; what was kept of the last one goes.
  virtual void start(std::span<const FramePtr> images) = 0;
  /// Pairs come ordered by reference, then by target.
  /// @pre reference < target < number of images.
  [[nodiscard]] virtual MatchedPair match(int reference, int target) = 0;
};

/// Median wall time of `runs` > 0 calls [ms].
template <class Work>
[[nodiscard]] double median_ms(int runs, const Work& work) {
  std::vector<double> walls_ms;
  for (int run = 0; run < runs; ++run) {
    const double start_ms = wall_ms();
    work();
    walls_ms.push_back(wall_ms() - start_ms);
  }
  return median(std::move(walls_ms));
}

}  // namespace corvid
