// disambiguate(): all modules together.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "frontend/disambiguate/disambiguate.h"
#include "frontend/epipolar.h"
#include "match_scene.h"

namespace corvid {
namespace {

struct Tally {
  int right = 0, wrong = 0, ambiguous = 0, without = 0;
};
Tally tally(const MatchSets& sets, const MatchScene& scene) {
  Tally t;
  for (std::size_t i = 0; i < sets.points.size(); ++i) {
    const MatchSets::Point& point = sets.points[i];
    EXPECT_EQ(point.candidates.size(), point.x_t.size());
    if (point.accepted) {
      EXPECT_LT(*point.accepted, point.candidates.size());
      ++((point.match() - scene.x_t[i]).norm() < 2 ? t.right : t.wrong);
    } else {
      ++(point.candidates.empty() ? t.without : t.ambiguous);
    }
  }
  // Nothing gets lost: U, M and those without candidates are all.
  EXPECT_EQ(static_cast<std::size_t>(t.right + t.wrong + t.ambiguous + t.without),
            sets.points.size());
  return t;
}

TEST(Disambiguate, FindsGeometryAndMatchesFromNothing) {
  SceneShape forward;
  forward.T_world_t = Pose(so3_exp({0.01, 0.02, 0}), {0.05, 0.02, 1.0});
  for (const SceneShape& shape : {SceneShape{}, forward}) {
    const MatchScene scene = make_scene(1500, 1, shape);
    MatchSets sets = make_candidates(scene, {.noise_px = 0.07}, 2);
    const Disambiguation result = disambiguate(sets, {});
    ASSERT_TRUE(result.F);
    EXPECT_NEAR(result.F->norm(), 1, 1e-9);
    for (std::size_t i = 0; i < scene.x_r.size(); ++i)
      EXPECT_LT(sampson_distance_px(*result.F, scene.x_r[i], scene.x_t[i]), 0.1);
    const Tally t = tally(sets, scene);
    EXPECT_GT(t.right, 1200) << "9 of 10 have a true candidate";
    EXPECT_LE(t.wrong, 3);
    EXPECT_EQ(result.report.runs.front().module, DisambiguationModule::unique);
    EXPECT_GT(result.report.total(DisambiguationModule::epipolar).accepted, 300);
    EXPECT_GT(result.report.total(DisambiguationModule::highest_scores).accepted, 80);
    EXPECT_GE(result.report.rounds, 2);
  }
}

TEST(Disambiguate, SectorsAndTopologyEarnTheirPlace) {
  const MatchScene scene = make_scene(3000, 3);
  const auto run = [&](const CandidateShape& shape, const DisambiguationOptions& options) {
    MatchSets sets = make_candidates(scene, shape, 4);
    EXPECT_TRUE(disambiguate(sets, options, scene.F_tr).F);
    return tally(sets, scene);
  };
  // Where F is known to a pixel only, ten times the distance is far: the sectors are narrower.
  DisambiguationOptions options;
  options.max_epipolar_px = 1;
  const CandidateShape strip{.noise_px = 0.3, .strip_px = 20};
  const Tally with_sectors = run(strip, options);
  options.sectors = false;
  EXPECT_GT(with_sectors.right, run(strip, options).right + 10);
  // On the line, F sees nothing wrong.
  const CandidateShape line{.noise_px = 0.05, .strip_px = 0.1};
  const Tally with_topology = run(line, {});
  options = {};
  options.topology = false;
  EXPECT_LT(4 * with_topology.wrong, run(line, options).wrong);
}

TEST(Disambiguate, ARepeatedPatternIsResolvedByTheEpipolarLineOrLeftAlone) {
  const MatchScene scene = make_scene(1200, 5);
  MatchSets sets = make_candidates(scene, {.noise_px = 0.05, .unique = 0.5, .wrong = 0}, 6);
  // Windows of a facade: copies every 40 px of a row, in both directions, or of a line's.
  std::vector<std::size_t> rows, lines;
  for (std::size_t i = 0; i < 400; ++i) {
    const Eigen::Vector3d line = scene.F_tr * scene.x_r[i].homogeneous();
    const Eigen::Vector2d along = Eigen::Vector2d(-line.y(), line.x()).normalized();
    const Eigen::Vector2d across(along.y(), -along.x());
    std::vector<Found> found;
    for (int k = -2; k <= 2; ++k)
      found.push_back({scene.x_t[i] + 40.0 * k * (i % 2 ? along : across), 0.95F});
    sets.points[i] = match_point(scene.x_r[i], found);
    (i % 2 ? lines : rows).push_back(i);
  }
  ASSERT_TRUE(disambiguate(sets, {}).F);
  int resolved = 0;
  for (std::size_t i : rows) {
    if (!sets.points[i].accepted) continue;
    ++resolved;
    EXPECT_LT((sets.points[i].match() - scene.x_t[i]).norm(), 1);
  }
  EXPECT_GT(resolved, 190);
  for (std::size_t i : lines) EXPECT_FALSE(sets.points[i].accepted) << "nobody can tell";
}

TEST(Disambiguate, AThirdViewResolvesWhatIsLeft) {
  const MatchScene scene = make_scene(800, 7);
  const auto candidates = [&] {
    MatchSets sets = make_candidates(scene, {.noise_px = 0.05, .unique = 0.6, .wrong = 0}, 8);
    for (std::size_t i = 0; i < 200; ++i) {
      const Eigen::Vector3d line = scene.F_tr * scene.x_r[i].homogeneous();
      const Eigen::Vector2d along = Eigen::Vector2d(-line.y(), line.x()).normalized();
      sets.points[i] =
          match_point(scene.x_r[i], {{scene.x_t[i] + 60 * along, 0.95F}, {scene.x_t[i], 0.94F}});
    }
    return sets;
  };
  AuxiliaryView view;
  for (const Eigen::Vector2d& x : scene.x_a) view.x_a.emplace_back(x);
  view.F_auxiliary_reference = scene.F_ar;
  view.support = [&](std::span<const AuxiliaryView::Probe> probes) {
    std::vector<float> scores;
    for (const auto& probe : probes)
      scores.push_back((probe.place - scene.x_a[probe.point]).norm() < 6 ? 0.95F : -1.0F);
    return scores;
  };
  MatchSets two = candidates(), three = candidates();
  ASSERT_TRUE(disambiguate(two, {}).F);
  const Disambiguation result = disambiguate(three, {}, std::nullopt, std::span(&view, 1));
  int right_two = 0, right_three = 0;
  for (std::size_t i = 0; i < 200; ++i) {
    right_two += two.points[i].accepted.has_value();
    right_three += three.points[i].accepted && (three.points[i].match() - scene.x_t[i]).norm() < 1;
  }
  EXPECT_EQ(right_two, 0);
  EXPECT_GT(right_three, 150);
  EXPECT_LE(tally(three, scene).wrong, 3);
  EXPECT_GT(result.report.total(DisambiguationModule::epipolar_transfer).accepted +
                result.report.total(DisambiguationModule::affine_transfer).accepted,
            150);
}

TEST(Disambiguate, NoiseGivesNoGeometryAndNoMatches) {
  const MatchScene scene = make_scene(2000, 9);
  for (double tau : {0.2, 1.0})
    for (double strip_px : {0.0, 10.0})
      for (bool known : {false, true}) {
        MatchSets sets = make_candidates(
            scene, {.unique = 0, .wrong = 0.6, .outstanding = 0, .others = 3, .strip_px = strip_px},
            10);
        // No true candidate at all.
        for (std::size_t i = 0; i < sets.points.size(); ++i) {
          MatchSets::Point& point = sets.points[i];
          for (std::size_t k = point.x_t.size(); k-- > 0;)
            if ((point.x_t[k] - scene.x_t[i]).norm() < 3) point.withdraw(k, Withdrawn::nothing);
        }
        DisambiguationOptions options;
        options.max_epipolar_px = tau;
        const Disambiguation result =
            disambiguate(sets, options, known ? std::optional(scene.F_tr) : std::nullopt);
        EXPECT_FALSE(result.F) << tau << " " << strip_px << " " << known;
        EXPECT_EQ(tally(sets, scene).right + tally(sets, scene).wrong, 0);
      }
}

TEST(Disambiguate, KnownGeometryLeadsWhereNothingIsUnique) {
  const MatchScene scene = make_scene(600, 11);
  MatchSets sets = make_candidates(
      scene, {.noise_px = 0.05, .unique = 0, .wrong = 0, .outstanding = 0, .others = 3}, 12);
  MatchSets again = sets;
  EXPECT_FALSE(disambiguate(again, {}).F) << "nothing to begin with";
  ASSERT_TRUE(disambiguate(sets, {}, scene.F_tr).F);
  const Tally t = tally(sets, scene);
  EXPECT_GT(t.right, 500);
  EXPECT_LE(t.wrong, 2);
  // A wrong one does not lead astray, and does no harm where the matches know better.
  const Eigen::Matrix3d wrong = scene.fundamental({}, Pose(so3_exp({0.4, 0, 0.3}), {0.1, 2, 1}));
  EXPECT_FALSE(disambiguate(again, {}, wrong).F);
  MatchSets clear = make_candidates(scene, {.noise_px = 0.05}, 13);
  ASSERT_TRUE(disambiguate(clear, {}, wrong).F);
  EXPECT_GT(tally(clear, scene).right, 450);
  EXPECT_FALSE(disambiguate(again, {}, Eigen::Matrix3d::Zero()).F);
  EXPECT_FALSE(disambiguate(again, {}, Eigen::Matrix3d::Constant(std::nan(""))).F);
}

TEST(Disambiguate, PlanesAndRotationsHaveSomeGeometryThatFits) {
  std::mt19937_64 random(14);
  std::uniform_real_distribution<double> u(0, 1);
  std::normal_distribution<double> noise(0, 0.05);
  Eigen::Matrix3d H;
  H << 1.02, 0.05, 6, -0.04, 0.99, -3, 4e-5, -3e-5, 1;
  for (const Eigen::Matrix3d& homography : {H, Eigen::Matrix3d(Eigen::Matrix3d::Identity())}) {
    MatchSets sets;
    for (int i = 0; i < 800; ++i) {
      const Eigen::Vector2d x(640 * u(random), 480 * u(random));
      const Eigen::Vector2d t = (homography * x.homogeneous()).hnormalized();
      sets.points.push_back(
          match_point(x, {{t + Eigen::Vector2d(noise(random), noise(random)), 0.9F}}));
    }
    const Disambiguation result = disambiguate(sets, {});
    ASSERT_TRUE(result.F);
    EXPECT_TRUE(result.F->allFinite());
    int kept = 0;
    for (const auto& point : sets.points) kept += point.accepted.has_value();
    EXPECT_GT(kept, 780);
  }
}

/// Every acceptance must be followed by a refusal: candidates that agree with F and jump about.
TEST(Disambiguate, EndsWhateverItIsGiven) {
  const MatchScene scene = make_scene(700, 15);
  std::mt19937_64 random(16);
  std::uniform_real_distribution<double> u(-1, 1);
  MatchSets sets = make_candidates(scene, {.noise_px = 0.05, .unique = 1, .wrong = 0}, 17);
  std::size_t candidates = 0;
  for (std::size_t i = 0; i < 500; ++i) {
    const Eigen::Vector3d line = scene.F_tr * scene.x_r[i].homogeneous();
    const Eigen::Vector2d along = Eigen::Vector2d(-line.y(), line.x()).normalized();
    const Eigen::Vector2d across(along.y(), -along.x());
    std::vector<Found> found;
    // Each is over 1.1 times the next, on the line to a tenth, and far away from where it belongs.
    double score = 0.99, off = 1e-5;
    for (int k = 0; k < 30; ++k, score /= 1.11, off *= 10.1)
      found.push_back({scene.x_t[i] + 300 * u(random) * along + std::min(off, 5.0) * across,
                       static_cast<float>(score)});
    sets.points[i] = match_point(scene.x_r[i], found);
    candidates += 30;
  }
  const Disambiguation result = disambiguate(sets, {});
  EXPECT_GT(result.report.rounds, 2);
  EXPECT_LE(result.report.rounds, 20);
  int withdrawn = 0;
  for (const ModuleRun& run : result.report.runs) {
    EXPECT_GE(run.ms, 0);
    withdrawn += run.counts.rejected;
  }
  EXPECT_LE(static_cast<std::size_t>(withdrawn), candidates + 200) << "none is taken away twice";
  tally(sets, scene);
  EXPECT_TRUE(result.F.value_or(Eigen::Matrix3d::Zero()).allFinite());
}

TEST(Disambiguate, AnyInputIsDefined) {
  const double nan = std::nan(""), infinity = std::numeric_limits<double>::infinity();
  std::vector<MatchSets> inputs(8);
  inputs[1].points = {match_point({1, 2}, {{{3, 4}, 0.9F}})};
  inputs[2].points = {match_point({1, 2}, {}), match_point({nan, 2}, {{{3, 4}, 0.9F}})};
  for (int i = 0; i < 200; ++i) {
    const double x = i;
    inputs[3].points.push_back(match_point({5, 5}, {{{6, 6}, 0.9F}}));
    inputs[4].points.push_back(match_point({x, 2 * x}, {{{3 * x, x}, 0.9F}}));
    inputs[5].points.push_back(match_point({1e300 * x, 1}, {{{1, 1e200 * x}, 0.9F}}));
    inputs[6].points.push_back(
        match_point({x, infinity}, {{{nan, 1}, 0.9F}, {{1, -infinity}, std::nanf("")}}));
    inputs[7].points.push_back(match_point({5, 5}, {{{6, 6}, 0.9F}, {{6, 6}, 0.9F}}));
  }
  const Eigen::Matrix3d rows = (Eigen::Matrix3d() << 0, 0, 0, 0, 0, -1, 0, 1, 0).finished();
  for (std::size_t i = 0; i < inputs.size(); ++i)
    for (const std::optional<Eigen::Matrix3d>& F :
         {std::optional<Eigen::Matrix3d>(), std::optional(rows)}) {
      MatchSets sets = inputs[i];
      AuxiliaryView view;
      view.x_a.resize(sets.points.size());
      for (auto& x : view.x_a) x = Eigen::Vector2d(7, 7);
      view.support = [](std::span<const AuxiliaryView::Probe> probes) {
        return std::vector<float>(probes.size(), 0.9F);
      };
      const Disambiguation result = disambiguate(sets, {}, F, std::span(&view, 1));
      EXPECT_TRUE(result.F.value_or(Eigen::Matrix3d::Zero()).allFinite());
      if (i == 4) continue;  // a line that moves in one piece: any F through it is right
      EXPECT_FALSE(result.F) << i;
      for (const auto& point : sets.points) EXPECT_FALSE(point.accepted) << i;
    }
}

TEST(Disambiguate, RepeatsItself) {
  const MatchScene scene = make_scene(800, 18);
  MatchSets a = make_candidates(scene, {.noise_px = 0.1}, 19), b = a;
  const auto first = disambiguate(a, {}), second = disambiguate(b, {});
  ASSERT_TRUE(first.F && second.F);
  EXPECT_EQ(*first.F, *second.F);
  for (std::size_t i = 0; i < a.points.size(); ++i)
    EXPECT_EQ(a.points[i].accepted, b.points[i].accepted);
}

}  // namespace
}  // namespace corvid
