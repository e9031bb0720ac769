#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "bench/matching/matching_report.h"
#include "bench/matching/pair_side.h"
#include "bench/matching/reconstruction.h"
#include "corvid/camera.h"

namespace corvid {

/// Adds up what one side makes of a set.
class Tally {
 public:
  /// @param F  the true one, where it is known.
  void add(const Camera& camera, const MatchedPair& pair, const std::optional<Eigen::Matrix3d>& F);
  void add(const Reconstruction& run);
  [[nodiscard]] SideFigures figures() const;

 private:
  struct Sums {
    long matches = 0;
    std::vector<double> ms, distances_px;
  };
  [[nodiscard]] static PairFigures of(const Sums& sums);

  Sums all_, gap1_, gap2_;
  Reconstruction total_;
};

}  // namespace corvid
