// The modules that need F, and those that need neighbours.
#include <gtest/gtest.h>

#include <algorithm>

#include "frontend/disambiguate/epipolar_constraint.h"
#include "frontend/disambiguate/epipolar_sectors.h"
#include "frontend/disambiguate/fundamental.h"
#include "frontend/disambiguate/match_topology.h"
#include "frontend/disambiguate/matched_mesh.h"
#include "frontend/disambiguate/unique.h"
#include "frontend/epipolar.h"
#include "match_scene.h"

namespace corvid {
namespace {

/// A pure forward motion: epipolar lines are rays out of (100, 100), in both images.
Eigen::Matrix3d rays_geometry() { return skew({100, 100, 1}); }

MatchSets::Point matched(const Eigen::Vector2d& x_r, const Eigen::Vector2d& x_t) {
  MatchSets::Point point = match_point(x_r, {{x_t, 0.9F}});
  point.accepted = 0;
  return point;
}

ModuleCounts run_sectors(MatchSets& sets, const Eigen::Matrix3d& F) {
  MatchedMesh mesh(sets);
  return reject_outside_sectors(sets, mesh, F, 0.2);
}

TEST(Sectors, CandidatesOutsideTheLinesOfTheEnclosingTriangleAreWithdrawn) {
  MatchSets sets;
  // A triangle over the rows 10 to 18; the sector is those rows of the target.
  sets.points = {
      matched({10, 10}, {30, 10}), matched({40, 18}, {60, 18}), matched({10, 18}, {30, 18}),
      match_point({18, 15},
                  {{{35, 13}, 0.9F}, {{50, 25}, 0.9F}, {{70, 9}, 0.9F}, {{90, 17.5}, 0.9F}}),
      match_point({90, 15}, {{{35, 80}, 0.9F}, {{50, 25}, 0.9F}})};
  const ModuleCounts counts = run_sectors(sets, rows_geometry());
  EXPECT_EQ(counts.in, 2);
  EXPECT_EQ(counts.rejected, 2);
  ASSERT_EQ(sets.points[3].x_t.size(), 2U);
  EXPECT_EQ(sets.points[3].x_t[0], Eigen::Vector2d(35, 13));
  EXPECT_EQ(sets.points[3].x_t[1], Eigen::Vector2d(90, 17.5));
  EXPECT_EQ(sets.points[3].last_withdrawn, Withdrawn::sectors);
  EXPECT_EQ(sets.points[4].x_t.size(), 2U) << "outside of the hull: left alone";
  EXPECT_EQ(run_sectors(sets, rows_geometry()).rejected, 0);
}

TEST(Sectors, TheCandidateOnThePointsOwnLineStaysHoweverNarrowTheSector) {
  MatchSets sets;
  sets.points = {matched({10, 14.99}, {30, 15}),
                 matched({40, 15.01}, {60, 15}),
                 matched({25, 15.01}, {45, 15}),
                 match_point({24, 15}, {{{35, 15.1}, 0.9F}, {{50, 15.6}, 0.9F}}),
                 matched({0, 0}, {20, 0}),
                 matched({60, 0}, {80, 0}),
                 matched({0, 30}, {20, 30}),
                 matched({60, 30}, {80, 30})};
  EXPECT_EQ(run_sectors(sets, rows_geometry()).rejected, 1);
  ASSERT_EQ(sets.points[3].x_t.size(), 1U);
  EXPECT_EQ(sets.points[3].x_t[0].y(), 15.1);
}

TEST(Sectors, ASectorIsOneSideOfAnEpipoleInsideTheImage) {
  MatchSets sets;
  // Moving forward, points move away from (100, 100), each on its own side.
  for (const Eigen::Vector2d& x : {Eigen::Vector2d(140, 90),
                                   {140, 110},
                                   {160, 100},
                                   {60, 90},
                                   {60, 110},
                                   {100, 60},
                                   {100, 140},
                                   {40, 100},
                                   {90, 60},
                                   {90, 150},
                                   {110, 50}})
    sets.points.push_back(
        matched(x, Eigen::Vector2d(100, 100) + 1.2 * (x - Eigen::Vector2d(100, 100))));
  const std::size_t ambiguous = sets.points.size();
  // On the true side; straight across the epipole; off the lines.
  sets.points.push_back(
      match_point({150, 100}, {{{160, 100}, 0.9F}, {{50, 100}, 0.9F}, {{160, 160}, 0.9F}}));
  // This one's triangle holds the epipole.
  sets.points.push_back(match_point({101, 101}, {{{103, 97}, 0.9F}, {{20, 30}, 0.9F}}));
  EXPECT_EQ(run_sectors(sets, rays_geometry()).rejected, 2);
  ASSERT_EQ(sets.points[ambiguous].x_t.size(), 1U);
  EXPECT_EQ(sets.points[ambiguous].x_t[0], Eigen::Vector2d(160, 100));
  EXPECT_EQ(sets.points[ambiguous + 1].x_t.size(), 2U);
}

TEST(Sectors, TrueCandidatesOfARealisticSceneStay) {
  for (const Pose& motion :
       {SceneShape{}.T_world_t, Pose(so3_exp({0, 0.02, 0.01}), {0.05, 0, 1})}) {
    SceneShape shape;
    shape.T_world_t = motion;
    const MatchScene scene = make_scene(1500, 5, shape);
    MatchSets sets = make_candidates(scene, {.noise_px = 0.05, .wrong = 0, .strip_px = 20}, 6);
    accept_unique(sets);
    std::size_t before = 0, after = 0, lost = 0;
    for (const auto& point : sets.points) before += point.in_m() ? point.x_t.size() - 1 : 0;
    run_sectors(sets, scene.F_tr);
    for (std::size_t i = 0; i < sets.points.size(); ++i) {
      const MatchSets::Point& point = sets.points[i];
      if (point.accepted) continue;
      const bool kept = std::any_of(point.x_t.begin(), point.x_t.end(),
                                    [&](const auto& x) { return (x - scene.x_t[i]).norm() < 1; });
      lost += !kept;
      after += point.x_t.size() - kept;
    }
    EXPECT_EQ(lost, 0U);
    EXPECT_LT(4 * after, 3 * before) << "and many of the wrong ones are gone";
  }
}

ModuleCounts run_topology(MatchSets& sets, int max_common = 1) {
  return reject_topology(sets, MatchedMesh(sets), max_common);
}

TEST(Topology, AMatchThatJumpsAwayFromItsNeighboursIsWithdrawn) {
  const MatchScene scene = make_scene(400, 11);
  MatchSets sets;
  for (std::size_t i = 0; i < scene.x_r.size(); ++i)
    sets.points.push_back(matched(scene.x_r[i], scene.x_t[i]));
  EXPECT_LE(run_topology(sets).rejected, 2) << "a step in depth may cost one";
  // Along its epipolar line, where F cannot tell.
  const std::size_t jump = 123;
  sets.points[jump] = matched(scene.x_r[jump], scene.x_t[jump]);
  const Eigen::Vector3d line = scene.F_tr * scene.x_r[jump].homogeneous();
  sets.points[jump].x_t[0] += 90 * Eigen::Vector2d(-line.y(), line.x()).normalized();
  ASSERT_LT(sampson_distance_px(scene.F_tr, scene.x_r[jump], sets.points[jump].x_t[0]), 1e-6);
  const ModuleCounts counts = run_topology(sets);
  EXPECT_GE(counts.rejected, 1);
  EXPECT_LE(counts.rejected, 3);
  EXPECT_FALSE(sets.points[jump].accepted || sets.points[jump].in_m());
  EXPECT_EQ(sets.points[jump].last_withdrawn, Withdrawn::topology);
}

TEST(Topology, OneCommonNeighbourIsNotEnough) {
  const MatchScene scene = make_scene(600, 12);
  const auto rejected = [&](int max_common) {
    MatchSets sets;
    for (std::size_t i = 0; i < scene.x_r.size(); ++i)
      sets.points.push_back(
          matched(scene.x_r[i], scene.x_t[i] + (i % 10 ? 0.0 : 35.0) * Eigen::Vector2d(0.8, 0.6)));
    return run_topology(sets, max_common).rejected;
  };
  EXPECT_GT(rejected(0), 0);
  EXPECT_GT(rejected(1), rejected(0));
  EXPECT_GT(rejected(2), rejected(1));
  EXPECT_LT(rejected(1), 90) << "60 have jumped";
}

TEST(Topology, FewOrDegenerateMatchesAreNotJudged) {
  for (int count : {0, 1, 2, 3}) {
    MatchSets sets;
    for (int i = 0; i < count; ++i)
      sets.points.push_back(matched({10.0 * i, 5.0 * i * i}, {3.0 * i, 7}));
    EXPECT_EQ(run_topology(sets).rejected, 0) << count;
  }
  MatchSets same, line;
  for (int i = 0; i < 40; ++i) {
    same.points.push_back(matched({10, 10}, {20, 20}));
    line.points.push_back(matched({10.0 * i, 10}, {12.0 * i, 20}));
  }
  EXPECT_EQ(run_topology(same).rejected, 0);
  EXPECT_EQ(run_topology(line).rejected, 0);
}

TEST(Fundamental, OutliersGoBackAndFIsFoundFromNothingAndFromABadStart) {
  const MatchScene scene = make_scene(600, 21);
  Eigen::Matrix3d bad = scene.F_tr;
  bad(0, 2) *= 1.5;
  DisambiguationOptions options;
  options.max_epipolar_px = 0.5;
  for (const std::optional<Eigen::Matrix3d>& start :
       {std::optional<Eigen::Matrix3d>(), std::optional(scene.F_tr), std::optional(bad)}) {
    MatchSets sets = make_candidates(scene, {.unique = 0.6, .wrong = 0.4}, 22);
    accept_unique(sets);
    std::optional<Eigen::Matrix3d> F = start;
    const ModuleCounts counts = fit_fundamental(sets, options, F);
    ASSERT_TRUE(F);
    EXPECT_EQ(counts.in, 600);
    EXPECT_GT(counts.rejected, 220);
    EXPECT_LT(counts.rejected, 260);
    for (std::size_t i = 0; i < scene.x_r.size(); ++i)
      EXPECT_LT(sampson_distance_px(*F, scene.x_r[i], scene.x_t[i]), 0.3);
  }
}

TEST(Fundamental, WhatChanceExplainsIsNoGeometry) {
  DisambiguationOptions options;
  options.max_epipolar_px = 1.0;
  const MatchScene scene = make_scene(3000, 31);
  // Anywhere in the image, or all of it in a strip about one geometry's lines.
  for (double strip_px : {0.0, 10.0}) {
    MatchSets sets = make_candidates(scene, {.unique = 0, .wrong = 1, .strip_px = strip_px}, 32);
    accept_unique(sets);
    std::optional<Eigen::Matrix3d> F;
    const ModuleCounts counts = fit_fundamental(sets, options, F);
    EXPECT_FALSE(F) << strip_px;
    EXPECT_EQ(counts.rejected, 0);
  }
  EXPECT_TRUE(beyond_chance(16, 16, 0.01));
  EXPECT_FALSE(beyond_chance(40, 5000, 0.005));
  EXPECT_TRUE(beyond_chance(400, 5000, 0.005));
  EXPECT_FALSE(beyond_chance(20, 20, 1));
  EXPECT_FALSE(beyond_chance(0, 0, 0.1));
  EXPECT_TRUE(beyond_chance(20, 20, 0));
}

TEST(Fundamental, AFewTrueMatchesAmongManyWrongOnesAreFoundByRansac) {
  const MatchScene scene = make_scene(1000, 41);
  MatchSets sets = make_candidates(scene, {.unique = 0.4, .wrong = 0.6}, 42);
  accept_unique(sets);
  std::optional<Eigen::Matrix3d> F;
  DisambiguationOptions options;
  options.max_epipolar_px = 0.4;
  fit_fundamental(sets, options, F);
  ASSERT_TRUE(F);
  for (std::size_t i = 0; i < scene.x_r.size(); ++i)
    EXPECT_LT(sampson_distance_px(*F, scene.x_r[i], scene.x_t[i]), 0.4);
}

}  // namespace
}  // namespace corvid
