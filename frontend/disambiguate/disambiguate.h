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

/// The modules of algorithms.md 4, in the order of the loop.
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
  /// window of algorithms.md 4.8. Empty: the epipolar transfer module does not use this view.
  struct Probe {
    std::size_t point = 0;
    Eigen::Vector2d place;
    Eigen::Vector2d line_direction;  ///< unit, along the reference point's epipolar line
  };
  std::function<std::vector<float>(std::span<const Probe>)> support;
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

/// Tells the candidates apart (algorithms.md 4): runs the modules that the options switch on in
/// a loop until nothing new is accepted, then epipolar transfer and a last pruning by F and
/// topology. The loop ends because a point that is thrown back to M has lost its candidate.
///
/// @param F  the geometry known so far; nothing: estimated from the unambiguous points.
/// Deterministic.
[[nodiscard]] Disambiguation disambiguate(MatchSets& sets, const DisambiguationOptions& options,
                                          const std::optional<Eigen::Matrix3d>& F = std::nullopt,
                                          std::span<const AuxiliaryView> auxiliary = {});

}  // namespace corvid
