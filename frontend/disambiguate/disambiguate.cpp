#include "frontend/disambiguate/disambiguate.h"

#include <algorithm>
#include <cmath>

#include "core/stopwatch.h"
#include "frontend/disambiguate/affine_transfer.h"
#include "frontend/disambiguate/epipolar_constraint.h"
#include "frontend/disambiguate/epipolar_sectors.h"
#include "frontend/disambiguate/epipolar_transfer.h"
#include "frontend/disambiguate/fundamental.h"
#include "frontend/disambiguate/highest_scores.h"
#include "frontend/disambiguate/match_topology.h"
#include "frontend/disambiguate/matched_mesh.h"
#include "frontend/disambiguate/unique.h"

namespace corvid {
namespace {

constexpr int kMaxRounds = 20;  // pairs need about four: a bound on the time of made-up ones

/// Places that no image has: numbers that are not finite or of more than a million pixels.
void withdraw_impossible(MatchSets& sets) {
  const auto possible = [](const Eigen::Vector2d& x) {
    return x.allFinite() && x.cwiseAbs().maxCoeff() <= 1e6;
  };
  for (MatchSets::Point& point : sets.points)
    for (std::size_t k = point.candidates.size(); k-- > 0;)
      if (!possible(point.x_r) || !possible(point.x_t[k])) point.withdraw(k, Withdrawn::geometry);
}

/// Candidates per point before any is withdrawn.
std::vector<std::size_t> candidate_counts(const MatchSets& sets) {
  std::vector<std::size_t> counts;
  for (const MatchSets::Point& point : sets.points)
    if (!point.candidates.empty()) counts.push_back(point.candidates.size());
  return counts;
}

/// Whether U is more than choosing the candidate nearest to any F would give.
bool beyond_choice(const MatchSets& sets, std::span<const std::size_t> candidates,
                   const Eigen::Matrix3d& F, const DisambiguationOptions& options) {
  const auto agreeing =
      static_cast<int>(std::count_if(sets.points.begin(), sets.points.end(),
                                     [](const auto& p) { return p.accepted.has_value(); }));
  if (agreeing < options.min_matches) return false;
  const double chance = chance_of_agreement(sets, F, options.max_epipolar_px);
  double chosen = 0;
  for (std::size_t count : candidates) chosen += 1 - std::pow(1 - chance, count);
  return beyond_chance(agreeing, static_cast<int>(candidates.size()),
                       chosen / static_cast<double>(candidates.size()));
}

}  // namespace

std::string_view to_string(DisambiguationModule module) {
  switch (module) {
    case DisambiguationModule::unique:
      return "unique";
    case DisambiguationModule::fundamental:
      return "fundamental matrix";
    case DisambiguationModule::highest_scores:
      return "highest scores";
    case DisambiguationModule::epipolar:
      return "epipolar constraint";
    case DisambiguationModule::sectors:
      return "epipolar sectors";
    case DisambiguationModule::affine_transfer:
      return "affine transfer";
    case DisambiguationModule::topology:
      return "match topology";
    case DisambiguationModule::epipolar_transfer:
      return "epipolar transfer";
  }
  return "unknown";
}

ModuleCounts DisambiguationReport::total(DisambiguationModule module) const {
  ModuleCounts sum;
  for (const ModuleRun& run : runs) {
    if (run.module != module) continue;
    sum.in += run.counts.in;
    sum.accepted += run.counts.accepted;
    sum.rejected += run.counts.rejected;
  }
  return sum;
}

Disambiguation disambiguate(MatchSets& sets, const DisambiguationOptions& options,
                            const std::optional<Eigen::Matrix3d>& F,
                            std::span<const AuxiliaryView> auxiliary) {
  Disambiguation result;
  DisambiguationReport& report = result.report;
  report.rounds = 1;
  int accepted = 0;    // since the last round
  bool fitted = true;  // F, to U as it is
  const auto run = [&](bool wanted, DisambiguationModule module, const auto& function) {
    if (!wanted) return;
    Stopwatch watch;
    const ModuleCounts counts = function();
    report.runs.push_back({module, report.rounds, counts, watch.lap_ms()});
    accepted += counts.accepted;
    fitted = fitted && counts.accepted + counts.rejected == 0;
  };
  withdraw_impossible(sets);
  const std::vector<std::size_t> candidates = candidate_counts(sets);
  const std::optional<Eigen::Matrix3d> known =
      F && F->allFinite() && F->norm() > 1e-300 ? F : std::nullopt;
  std::optional<Eigen::Matrix3d>& now = result.F;
  now = known;
  // F stands on matches that were accepted without F: they prove it. One that was given may lead,
  // but what it chose must be more than what any F would have chosen.
  bool proven = false, led = false;
  const auto fit = [&] {
    run(!fitted, DisambiguationModule::fundamental, [&] {
      std::optional<Eigen::Matrix3d> next = now;
      const ModuleCounts counts = fit_fundamental(sets, options, next);
      proven = next && (proven || !led);
      now = next ? next : known;
      return counts;
    });
    fitted = true;
  };
  std::optional<MatchedMesh> mesh;
  const auto topology = [&] {
    run(options.topology && now, DisambiguationModule::topology, [&] {
      if (!mesh) mesh.emplace(sets);
      return reject_topology(sets, *mesh, options.topology_neighbours);
    });
    mesh.reset();
  };

  run(true, DisambiguationModule::unique, [&] { return accept_unique(sets); });
  fit();
  for (;; ++report.rounds) {
    led = led || now;
    run(options.highest_scores, DisambiguationModule::highest_scores,
        [&] { return accept_highest_scores(sets, options.ratio_highest_scores); });
    run(options.epipolar && now, DisambiguationModule::epipolar, [&] {
      return accept_epipolar(sets, *now, options.ratio_epipolar, options.max_epipolar_px);
    });
    for (const AuxiliaryView& view : auxiliary)
      run(options.affine_transfer && now, DisambiguationModule::affine_transfer,
          [&] { return accept_affine_transfer(sets, view, options); });
    // Everything accepted leaves U only by losing its candidate: there is a last round.
    if (accepted == 0 || report.rounds == kMaxRounds) break;
    accepted = 0;
    run(options.sectors && now, DisambiguationModule::sectors, [&] {
      mesh.emplace(sets);
      return reject_outside_sectors(sets, *mesh, *now, options.max_epipolar_px);
    });
    topology();
    fit();
  }
  for (const AuxiliaryView& view : auxiliary)
    run(options.epipolar_transfer && now, DisambiguationModule::epipolar_transfer,
        [&] { return accept_epipolar_transfer(sets, *now, view, options); });
  if (accepted > 0) topology();
  fit();

  // A given F that U could not be fitted to: nothing that is against it goes out.
  if (now && !proven)
    run(true, DisambiguationModule::fundamental,
        [&] { return reject_epipolar_outliers(sets, *now, options.max_epipolar_px); });
  if (now && !proven && !beyond_choice(sets, candidates, *now, options)) now.reset();
  if (!now)
    for (MatchSets::Point& point : sets.points) point.accepted.reset();
  return result;
}

}  // namespace corvid
