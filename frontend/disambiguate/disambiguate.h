#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "corvid/options.h"
#include "frontend/disambiguate/match_sets.h"

namespace corvid {

/// The modules of algorithms.md 4.
enum class DisambiguationModule {
  unique,       ///< points with one candidate enter U
  fundamental,  ///< RANSAC for F over U, outliers back to M
  highest_scores,
  epipolar,
  sectors,
  affine_transfer,
  topology,
  epipolar_transfer,  ///< once, after the loop
};
inline constexpr int kDisambiguationModules = 8;
[[nodiscard]] std::string_view to_string(DisambiguationModule module);

/// A third view: an image matched to the reference before.
struct AuxiliaryView {
  /// Of each point of the MatchSets, its match here (undistorted px), where there is one.
  std::vector<std::optional<Eigen::Vector2d>> x_a;
  Eigen::Matrix3d F_auxiliary_reference = Eigen::Matrix3d::Zero();  ///< x_a^T F x_r = 0
  /// x_a^T F x_t = 0; nothing: estimated from the triplets (indirect matches).
  std::optional<Eigen::Matrix3d> F_auxiliary_target;
  /// The NCC peak of the reference point's template near a place in this image (both
  /// undistorted px): a batch of (point, place) to scores, < 0 where there is no peak within the
  /// window of algorithms.md 4.8, NaN where that cannot be seen: outside of the image, say. Empty:
  /// the epipolar transfer module does not use this view.
  struct Probe {
    std::size_t point = 0;
    Eigen::Vector2d place;
    Eigen::Vector2d line_direction;  ///< unit, along the reference point's epipolar line
  };
  std::function<std::vector<float>(std::span<const Probe>)> support;
  double peak_quality = 0.85;  ///< Q_m (thesis 4.3.1): what supports a candidate, share of the best
};

/// One run of one module.
struct ModuleRun {
  DisambiguationModule module = DisambiguationModule::unique;
  int round = 0;  ///< of the loop, from 1
  ModuleCounts counts;
  double ms = 0;
};

struct DisambiguationReport {
  std::vector<ModuleRun> runs;  ///< in the order in which they ran
  int rounds = 0;
  /// Sum of a module's counts over the rounds.
  [[nodiscard]] ModuleCounts total(DisambiguationModule module) const;
};

struct Disambiguation {
  std::optional<Eigen::Matrix3d> F;  ///< refined over U; nothing: too few agree
  DisambiguationReport report;
};

/// Tells the candidates apart (algorithms.md 4). Unique points and F first; then rounds, until one
/// accepts nothing: highest scores, epipolar constraint, affine transfer; sectors, whose
/// withdrawals the next round looks at, topology, F again. The rounds end because a point that is
/// thrown back to M has lost its candidate. Then once: epipolar transfer, topology if it accepted
/// anything, F.
///
/// There is no geometry, and U is emptied without a candidate being withdrawn, if fewer than
/// options.min_matches agree, or no more than chance gives (fundamental.h). Places that are not
/// finite or beyond a million pixels are no candidates. Deterministic.
///
/// @param F  the geometry known so far: it begins, and chooses where nothing is unique; matches
/// that
///           agree on another one overrule it. Nothing: estimated from the unambiguous points.
[[nodiscard]] Disambiguation disambiguate(MatchSets& sets, const DisambiguationOptions& options,
                                          const std::optional<Eigen::Matrix3d>& F = std::nullopt,
                                          std::span<const AuxiliaryView> auxiliary = {});

}  // namespace corvid
