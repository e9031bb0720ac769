// The modules that ask a third view: exact correction, transfers, indirect matches.
#include <gtest/gtest.h>

#include <Eigen/SVD>
#include <cmath>
#include <limits>
#include <random>

#include "frontend/disambiguate/affine_transfer.h"
#include "frontend/disambiguate/correct_match.h"
#include "frontend/disambiguate/epipolar_transfer.h"
#include "frontend/disambiguate/indirect_matches.h"
#include "frontend/disambiguate/unique.h"
#include "frontend/epipolar.h"
#include "match_scene.h"

namespace corvid {
namespace {

using std::nullopt;

/// The least distance by trying the pencil of epipolar lines, finer and finer.
double least_distance(const Eigen::Matrix3d& F, const Eigen::Vector2d& x_r,
                      const Eigen::Vector2d& x_t) {
  // A line of the reference is named by a point on the normal through x_r to its own line.
  const Eigen::Vector3d own = F.transpose() * x_t.homogeneous();
  const Eigen::Vector2d across = own.head<2>().normalized();
  const Eigen::Vector3d epipole =
      Eigen::JacobiSVD<Eigen::Matrix3d>(F, Eigen::ComputeFullV).matrixV().col(2);
  const auto distance = [&](double s) {
    const Eigen::Vector3d point = (x_r + s * across).homogeneous();
    const Eigen::Vector3d l = epipole.cross(point), m = F * point;
    const double d = l.dot(x_r.homogeneous()) / l.head<2>().norm();
    const double e = m.dot(x_t.homogeneous()) / m.head<2>().norm();
    return d * d + e * e;
  };
  double best = 0, reach = 50;
  for (int round = 0; round < 12; ++round, reach /= 8) {
    double centre = best;
    for (int k = -200; k <= 200; ++k)
      if (distance(centre + reach * k / 200) < distance(best)) best = centre + reach * k / 200;
  }
  return std::sqrt(distance(best));
}

TEST(CorrectMatch, IsTheNearestPairOnF) {
  const MatchScene sideways = make_scene(60, 1);
  SceneShape forward_shape;
  forward_shape.T_world_t = Pose(so3_exp({0.01, 0.02, 0.0}), {0.05, 0.02, 1.0});
  const MatchScene forward = make_scene(60, 2, forward_shape);
  Eigen::Matrix3d rows;  // both epipoles at infinity
  rows << 0, 0, 0, 0, 0, -1, 0, 1, 0;
  std::mt19937_64 random(3);
  std::normal_distribution<double> noise(0, 1);
  for (const auto* scene : {&sideways, &forward})
    for (const Eigen::Matrix3d& F : {scene->F_tr, Eigen::Matrix3d(-1e5 * scene->F_tr), rows})
      for (double size_px : {0.01, 1.0, 8.0})
        for (std::size_t i = 0; i < 60; ++i) {
          const Eigen::Vector2d x_r = scene->x_r[i];
          Eigen::Vector2d x_t =
              scene->x_t[i] + size_px * Eigen::Vector2d(noise(random), noise(random));
          if (F == rows) x_t.y() = x_r.y() + size_px * noise(random);
          const auto [r, t] = correct_match(F, x_r, x_t);
          ASSERT_LT(sampson_distance_px(F, r, t), 1e-9);
          const double moved = std::sqrt((r - x_r).squaredNorm() + (t - x_t).squaredNorm());
          ASSERT_NEAR(moved, least_distance(F, x_r, x_t), 1e-6);
        }
}

TEST(CorrectMatch, ExactAndBadPairsComeBackDefined) {
  const MatchScene scene = make_scene(20, 4);
  const auto [r, t] = correct_match(scene.F_tr, scene.x_r[0], scene.x_t[0]);
  EXPECT_LT((r - scene.x_r[0]).norm() + (t - scene.x_t[0]).norm(), 1e-6);
  const double nan = std::nan(""), infinity = std::numeric_limits<double>::infinity();
  const Eigen::Vector2d x(3, 4);
  EXPECT_EQ(correct_match(Eigen::Matrix3d::Zero(), x, x).first, x);
  EXPECT_EQ(correct_match(Eigen::Matrix3d::Constant(nan), x, x).second, x);
  EXPECT_EQ(correct_match(scene.F_tr, x, {infinity, 0}).first, x);
  const auto [a, b] = correct_match(scene.F_tr, {1e200, 1}, {1, -1e200});
  EXPECT_TRUE(a.allFinite() && b.allFinite());
  // At the epipole.
  const Eigen::Matrix3d rays = skew({100, 100, 1});
  const auto [c, d] = correct_match(rays, {100, 100}, {150, 120});
  EXPECT_LT((c - Eigen::Vector2d(100, 100)).norm() + (d - Eigen::Vector2d(150, 120)).norm(), 1e-9);
}

TEST(CrossLines, ParallelLinesHaveNoCrossing) {
  const auto crossing = cross_lines({0, 2, -20}, {3, 0, -15});  // y = 10, x = 5
  ASSERT_TRUE(crossing);
  EXPECT_LT((crossing->place - Eigen::Vector2d(5, 10)).norm(), 1e-12);
  EXPECT_NEAR(std::abs(crossing->direction.x()), 1, 1e-12);
  EXPECT_NEAR(crossing->sine, 1, 1e-12);
  EXPECT_FALSE(cross_lines({0, 1, -10}, {0, 1, -11}));
  EXPECT_FALSE(cross_lines({0, 1, -10}, {0, 0, 0}));
}

TEST(IndirectMatches, ChainWhereOnePointAloneIsNear) {
  const std::vector<std::optional<Eigen::Vector2d>> x_2{
      Eigen::Vector2d(10, 10),  nullopt,
      Eigen::Vector2d(50, 50),  Eigen::Vector2d(90, 90),
      Eigen::Vector2d(-7, -7),  Eigen::Vector2d(std::nan(""), 1),
      Eigen::Vector2d(1e300, 0)};
  const std::vector<Eigen::Vector2d> x_2_hat{{11, 10.5}, {14.5, 10}, {50, 50.5},
                                             {51, 51},   {90, 95},   {-7.5, -7}};
  const std::vector<Eigen::Vector2d> x_3{{1, 1}, {2, 2}, {3, 3}, {4, 4}, {5, 5}, {6, 6}};
  const auto found = indirect_matches(x_2, x_2_hat, x_3, 1.5, 2.0);
  ASSERT_EQ(found.size(), x_2.size());
  EXPECT_EQ(found[0], Eigen::Vector2d(1, 1));
  EXPECT_EQ(found[1], nullopt);
  EXPECT_EQ(found[2], nullopt) << "two are near";
  EXPECT_EQ(found[3], nullopt) << "none is near";
  EXPECT_EQ(found[4], Eigen::Vector2d(6, 6));
  EXPECT_EQ(found[5], nullopt);
  EXPECT_EQ(found[6], nullopt);
  EXPECT_TRUE(indirect_matches({}, x_2_hat, x_3, 1.5, 2.0).empty());
  EXPECT_EQ(indirect_matches(x_2, {}, {}, 1.5, 2.0)[0], nullopt);
}

TEST(IndirectMatches, TheGridFindsWhatTryingAllFinds) {
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> u(-100, 100);
  std::vector<std::optional<Eigen::Vector2d>> x_2;
  std::vector<Eigen::Vector2d> x_2_hat;
  for (int i = 0; i < 2000; ++i) x_2_hat.emplace_back(u(random), u(random));
  for (int i = 0; i < 1000; ++i) x_2.emplace_back(Eigen::Vector2d(u(random), u(random)));
  const auto found = indirect_matches(x_2, x_2_hat, x_2_hat, 1.5, 2.0);
  int matched = 0;
  for (std::size_t i = 0; i < x_2.size(); ++i) {
    double d1 = 1e9, d2 = 1e9;
    for (const Eigen::Vector2d& x : x_2_hat) {
      const double d = (x - *x_2[i]).norm();
      d2 = std::min(d2, std::max(d, d1));
      d1 = std::min(d1, d);
    }
    EXPECT_EQ(found[i].has_value(), d1 < 2 && d2 > 2 && d2 > 1.5 * d1);
    if (found[i]) {
      EXPECT_NEAR((*found[i] - *x_2[i]).norm(), d1, 1e-12);
    }
    matched += found[i].has_value();
  }
  EXPECT_GT(matched, 100);
}

/// Far away and hardly turned: nearly affine.
SceneShape distant() {
  SceneShape shape;
  shape.nearest = 100;
  shape.farthest = 110;
  shape.T_world_t = Pose(so3_exp({0.0, -0.01, 0.05}), {8.0, 1.0, 0.3});
  shape.T_world_a = Pose(so3_exp({-0.01, 0.0, 0.0}), {-1.0, 7.0, -0.3});
  return shape;
}

AuxiliaryView auxiliary_of(const MatchScene& scene) {
  AuxiliaryView view;
  for (const Eigen::Vector2d& x : scene.x_a) view.x_a.emplace_back(x);
  view.F_auxiliary_reference = scene.F_ar;
  return view;
}

/// U: every other point. M: the true candidate and one 25 px along the epipolar line, where two
/// views cannot tell.
MatchSets along_the_line(const MatchScene& scene) {
  MatchSets sets;
  for (std::size_t i = 0; i < scene.x_r.size(); ++i) {
    const Eigen::Vector3d line = scene.F_tr * scene.x_r[i].homogeneous();
    const Eigen::Vector2d along = Eigen::Vector2d(-line.y(), line.x()).normalized();
    sets.points.push_back(
        match_point(scene.x_r[i], {{scene.x_t[i] + 25 * along, 0.95F}, {scene.x_t[i], 0.94F}}));
    if (i % 2 == 0) {
      sets.points.back().accepted = 1;
      sets.points.back().withdraw(0, Withdrawn::nothing);
    }
  }
  return sets;
}

TEST(AffineTransfer, TellsCandidatesOnOneEpipolarLineApart) {
  const MatchScene scene = make_scene(200, 6, distant());
  MatchSets sets = along_the_line(scene);
  AuxiliaryView view = auxiliary_of(scene);
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> u(0, 400);
  for (std::size_t i = 0; i < 60; i += 2) view.x_a[i] = {u(random), u(random)};  // wrong triplets
  view.x_a[101].reset();
  const ModuleCounts counts = accept_affine_transfer(sets, view, {});
  EXPECT_EQ(counts.in, 99);
  EXPECT_GT(counts.accepted, 90);
  for (std::size_t i = 1; i < sets.points.size(); i += 2)
    EXPECT_EQ(sets.points[i].accepted.value_or(1), 1U) << i;
  EXPECT_FALSE(sets.points[101].accepted) << "not seen in the auxiliary view";
}

TEST(AffineTransfer, AThirdViewThatSaysSomethingElseLeavesThePointAmbiguous) {
  const MatchScene scene = make_scene(200, 6, distant());
  MatchSets sets = along_the_line(scene);
  AuxiliaryView view = auxiliary_of(scene);
  // Half way between both candidates' transfers: neither is near.
  const auto exact = estimate_affine_transfer(
      [&] {
        std::vector<Triplet> all;
        for (std::size_t i = 0; i < scene.x_r.size(); ++i)
          all.push_back({scene.x_r[i], scene.x_a[i], scene.x_t[i]});
        return all;
      }(),
      10, 16, 1);
  ASSERT_TRUE(exact);
  EXPECT_EQ(exact->inliers, 200);
  view.x_a[1] = *view.x_a[1] + Eigen::Vector2d(60, 60);
  accept_affine_transfer(sets, view, {});
  EXPECT_FALSE(sets.points[1].accepted);
}

TEST(AffineTransfer, PlanesStandingCamerasAndTooFewTripletsAreDefined) {
  std::mt19937_64 random(8);
  std::normal_distribution<double> noise(0, 0.1);
  std::uniform_real_distribution<double> u(0, 500);
  std::vector<Triplet> plane, standing, same(30, {{1, 2}, {3, 4}, {5, 6}}), bad;
  for (int i = 0; i < 60; ++i) {
    const Eigen::Vector2d x(u(random), u(random));
    const auto jitter = [&] { return Eigen::Vector2d(noise(random), noise(random)); };
    plane.push_back({x, 1.1 * x + jitter(), Eigen::Vector2d(7, 9) + 0.9 * x + jitter()});
    standing.push_back({x, x + jitter(), x + Eigen::Vector2d(u(random), 0)});
    bad.push_back({x, {std::nan(""), 0}, x});
  }
  const auto transfer = estimate_affine_transfer(plane, 10, 16, 1);
  ASSERT_TRUE(transfer);
  EXPECT_EQ(transfer->inliers, 60);
  EXPECT_LT(transfer->largest_error_px, 1);
  EXPECT_LT(transfer->linear.norm(), 0.9) << "noise is not taken for structure";
  EXPECT_FALSE(estimate_affine_transfer(standing, 10, 16, 1));
  EXPECT_FALSE(estimate_affine_transfer(bad, 10, 16, 1));
  EXPECT_FALSE(estimate_affine_transfer(std::span(plane).first(3), 10, 3, 1));
  EXPECT_FALSE(estimate_affine_transfer({}, 10, 0, 1));
  const auto one = estimate_affine_transfer(same, 10, 16, 1);
  ASSERT_TRUE(one);
  EXPECT_TRUE(one->linear.allFinite() && one->offset.allFinite());
}

/// A third image in which the features of a scene are seen where they are, and nowhere else.
auto looks_like(const MatchScene& scene, int& calls) {
  return [&scene, &calls](std::span<const AuxiliaryView::Probe> probes) {
    ++calls;
    std::vector<float> scores;
    for (const AuxiliaryView::Probe& probe : probes) {
      EXPECT_NEAR(probe.line_direction.norm(), 1, 1e-9);
      const Eigen::Vector2d off = scene.x_a[probe.point] - probe.place;
      const double along = std::abs(off.dot(probe.line_direction));
      const double across = std::sqrt(std::max(0.0, off.squaredNorm() - along * along));
      scores.push_back(along <= 15 && across <= 3 ? 0.9F : -1.0F);
    }
    return scores;
  };
}

TEST(EpipolarTransfer, TheThirdImageTellsWhatTwoCannotAndIsAskedOnce) {
  const MatchScene scene = make_scene(300, 9);
  for (bool known : {true, false}) {
    MatchSets sets = along_the_line(scene);
    AuxiliaryView view = auxiliary_of(scene);
    if (known) view.F_auxiliary_target = scene.F_at;
    int calls = 0;
    view.support = looks_like(scene, calls);
    const ModuleCounts counts = accept_epipolar_transfer(sets, scene.F_tr, view, {});
    EXPECT_EQ(calls, 1);
    EXPECT_EQ(counts.in, 150);
    EXPECT_GT(counts.accepted, 100) << known;
    for (std::size_t i = 1; i < sets.points.size(); i += 2)
      EXPECT_EQ(sets.points[i].accepted.value_or(1), 1U) << i;
  }
}

TEST(EpipolarTransfer, TwoSupportedCandidatesOrAWeakOneAreNoAnswer) {
  const MatchScene scene = make_scene(300, 9);
  for (float score : {0.9F, 0.5F, -1.0F}) {
    MatchSets sets = along_the_line(scene);
    AuxiliaryView view = auxiliary_of(scene);
    view.F_auxiliary_target = scene.F_at;
    view.support = [score](std::span<const AuxiliaryView::Probe> probes) {
      std::vector<float> scores(probes.size(), score);
      if (score < 0.9F) scores[0] = 0.5F;  // alone, but far below the candidates' 0.95
      return scores;
    };
    EXPECT_EQ(accept_epipolar_transfer(sets, scene.F_tr, view, {}).accepted, 0) << score;
  }
}

TEST(EpipolarTransfer, HowGoodAPeakMustBeIsTheViewsToSay) {
  const MatchScene scene = make_scene(300, 9);
  for (const double quality : {0.85, 0.5}) {
    MatchSets sets = along_the_line(scene);
    AuxiliaryView view = auxiliary_of(scene);
    view.F_auxiliary_target = scene.F_at;
    view.peak_quality = quality;
    view.support = [](std::span<const AuxiliaryView::Probe> probes) {
      std::vector<float> scores(probes.size(), -1.0F);
      scores[0] = 0.55F;  // of the candidates' 0.95: 0.58
      return scores;
    };
    EXPECT_EQ(accept_epipolar_transfer(sets, scene.F_tr, view, {}).accepted, quality < 0.58);
  }
}

TEST(EpipolarTransfer, OnTheTrifocalPlaneThereIsNoAnswer) {
  MatchSets sets;
  AuxiliaryView view;
  MatchScene scene;
  int calls = 0;
  // The three centres on one line: all lines coincide; and nearly so.
  for (double off : {0.01, 0.0}) {
    SceneShape line;
    line.T_world_a = Pose(so3_exp({0.03, 0.05, 0}),
                          2 * line.T_world_t.translation() + Eigen::Vector3d(0, off, 0));
    scene = make_scene(300, 10, line);
    sets = along_the_line(scene);
    view = auxiliary_of(scene);
    view.F_auxiliary_target = scene.F_at;
    view.support = looks_like(scene, calls);
    EXPECT_EQ(accept_epipolar_transfer(sets, scene.F_tr, view, {}).accepted, 0) << off;
  }
  // Without an image to look at, or a geometry to transfer with.
  view.support = nullptr;
  EXPECT_EQ(accept_epipolar_transfer(sets, scene.F_tr, view, {}).accepted, 0);
  view.support = looks_like(scene, calls);
  view.F_auxiliary_target.reset();
  view.x_a.assign(sets.points.size(), nullopt);
  EXPECT_EQ(accept_epipolar_transfer(sets, scene.F_tr, view, {}).accepted, 0);
  EXPECT_EQ(calls, 0);
}

}  // namespace
}  // namespace corvid
