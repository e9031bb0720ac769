#pragma once

#include <Eigen/Core>
#include <ostream>
#include <string>
#include <vector>

#include "apps/match_images.h"
#include "core/stopwatch.h"
#include "frontend/pair_matcher.h"

namespace corvid {

/// What `corvid match` found.
struct MatchRun {
  std::vector<MatchImage> images;      ///< reference, target, auxiliary images
  std::vector<MatchView> views;        ///< of the images
  std::vector<PairMatches> auxiliary;  ///< reference to each auxiliary image
  PairMatches pair;                    ///< reference to target
  Timings timings;                     ///< [ms], all steps in order
  std::string device;
};

/// Sizes, counts, F, the modules' counts per round and the times.
void print(std::ostream& out, const MatchRun& run);
/// x_r, y_r, x_t, y_t [px, distorted], NCC score, covariance of the target's pixel [px^2]; a line
/// with the names first.
[[nodiscard]] std::string matches_csv(const PairMatches& pair);
/// The same as print() for programs (docs/formats.md).
[[nodiscard]] std::string match_json(const MatchRun& run);

}  // namespace corvid
