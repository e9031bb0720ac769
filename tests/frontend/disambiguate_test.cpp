#include <gtest/gtest.h>

#include "frontend/disambiguate/epipolar_constraint.h"
#include "frontend/disambiguate/highest_scores.h"
#include "frontend/disambiguate/ratio_inequalities.h"
#include "frontend/disambiguate/unique.h"
#include "frontend/disambiguate/weak_corners.h"
#include "match_scene.h"

namespace corvid {
namespace {

TEST(RatioInequalities, TheBestIsTakenOnlyIfItIsGoodAndNoOtherIs) {
  const auto test = [](std::vector<double> costs) { return ratio_inequalities(costs, 1.5, 2.0); };
  EXPECT_EQ(test({5, 1, 4}), 1U);
  EXPECT_FALSE(test({0.1, 1.9})) << "both are good, whatever their ratio";
  EXPECT_FALSE(test({2.5, 50})) << "none is good";
  EXPECT_FALSE(test({1.9, 2.1})) << "the second is nearly as good";
  EXPECT_EQ(test({1.9}), 0U) << "alone";
  EXPECT_FALSE(test({2.0}));
  EXPECT_FALSE(test({}));
  EXPECT_FALSE(test({std::nan("")}));
  EXPECT_EQ(test({std::nan(""), 1, 9}), 1U);
  EXPECT_FALSE(test({1, 1})) << "the same place twice";
}

TEST(Unique, OnlyPointsWithOneCandidateAreTaken) {
  MatchSets sets;
  sets.points = {match_point({1, 1}, {{{2, 2}, 0.9F}}),
                 match_point({1, 1}, {{{2, 2}, 0.9F}, {{3, 3}, 0.1F}}), match_point({1, 1}, {}),
                 match_point({1, 1}, {{{2, 2}, 0.0F}})};
  const ModuleCounts counts = accept_unique(sets);
  EXPECT_EQ(counts.in, 3);
  EXPECT_EQ(counts.accepted, 1);
  EXPECT_EQ(sets.points[0].accepted, 0U);
  EXPECT_FALSE(sets.points[1].accepted || sets.points[2].accepted);
  EXPECT_FALSE(sets.points[3].accepted) << "a score of nothing";
}

TEST(MatchSets, WithdrawingACandidateKeepsTheAcceptedOne) {
  MatchSets::Point p = match_point({0, 0}, {{{1, 1}, 0.9F}, {{2, 2}, 0.8F}, {{3, 3}, 0.7F}});
  p.accepted = 1;
  p.withdraw(0, Withdrawn::sectors);
  EXPECT_EQ(p.match(), Eigen::Vector2d(2, 2));
  p.withdraw(1, Withdrawn::sectors);
  EXPECT_EQ(p.match(), Eigen::Vector2d(2, 2));
  p.withdraw(0, Withdrawn::topology);
  EXPECT_FALSE(p.accepted || p.in_m());
  EXPECT_EQ(p.last_withdrawn, Withdrawn::topology);
}

TEST(HighestScores, AcceptsTheOneThatStandsOutAndAbstainsOnRepeatedPatterns) {
  MatchSets sets;
  sets.points = {
      match_point({10, 10}, {{{12, 10}, 0.95F}, {{80, 10}, 0.80F}}),
      match_point({20, 10}, {{{22, 10}, 0.95F}, {{90, 10}, 0.93F}}),  // identical windows
      match_point({30, 10}, {{{31, 10}, 0.90F}}), match_point({40, 10}, {})};
  const ModuleCounts counts = accept_highest_scores(sets, 1.1);
  EXPECT_EQ(counts.in, 2);
  EXPECT_EQ(counts.accepted, 1);
  EXPECT_EQ(sets.points[0].accepted, 0U);
  EXPECT_FALSE(sets.points[1].accepted);
  EXPECT_FALSE(sets.points[2].accepted) << "nothing to compare with";
  EXPECT_FALSE(sets.points[3].accepted);
  EXPECT_EQ(accept_highest_scores(sets, 1.1).accepted, 0);  // nothing new: the loop may end
}

TEST(WeakCorners, NothingIsWeakerThanATextureThatIsNotThere) {
  constexpr int kWidth = 100, kHeight = 80;
  const Eigen::Vector2f middle(50, 40), border(2, 40);
  EXPECT_TRUE(is_weak_corner(100, 10, middle, kWidth, kHeight, 5));
  EXPECT_FALSE(is_weak_corner(100, 30, middle, kWidth, kHeight, 5));
  EXPECT_TRUE(is_weak_corner(100, 0, middle, kWidth, kHeight, 5)) << "a flat wall";
  EXPECT_FALSE(is_weak_corner(100, 0, border, kWidth, kHeight, 5)) << "0 there: not known";
  EXPECT_FALSE(is_weak_corner(0, 0, middle, kWidth, kHeight, 5));
}

TEST(EpipolarConstraint, ChoosesTheCandidateOnTheLineOnlyIfTheOthersAreFarFromIt) {
  MatchSets sets;
  sets.points = {
      match_point({10, 10}, {{{50, 30}, 0.95F}, {{20, 10.05}, 0.94F}}),
      match_point({10, 20}, {{{50, 20.1}, 0.95F}, {{90, 20.15}, 0.94F}}),  // both on the line
      match_point({10, 30}, {{{15, 30.1}, 0.90F}}), match_point({10, 40}, {{{15, 45}, 0.90F}})};
  const ModuleCounts counts = accept_epipolar(sets, rows_geometry(), 10, 0.2);
  EXPECT_EQ(counts.in, 4);
  EXPECT_EQ(counts.accepted, 2);
  EXPECT_EQ(sets.points[0].accepted, 1U);
  EXPECT_FALSE(sets.points[1].accepted);
  EXPECT_EQ(sets.points[2].accepted, 0U);
  EXPECT_FALSE(sets.points[3].accepted);
}

TEST(EpipolarConstraint, AnOutlierThrownBackHasLostItsMatch) {
  MatchSets sets;
  sets.points = {match_point({10, 10}, {{{20, 14}, 0.95F}, {{30, 10}, 0.7F}}),
                 match_point({10, 20}, {{{20, 20.1}, 0.95F}})};
  accept_unique(sets);
  accept_highest_scores(sets, 1.1);
  ASSERT_TRUE(sets.points[0].accepted && sets.points[1].accepted);
  const ModuleCounts counts = reject_epipolar_outliers(sets, rows_geometry(), 0.5);
  EXPECT_EQ(counts.in, 2);
  EXPECT_EQ(counts.rejected, 1);
  EXPECT_FALSE(sets.points[0].accepted);
  ASSERT_EQ(sets.points[0].candidates.size(), 1U);
  EXPECT_FLOAT_EQ(sets.points[0].candidates[0].score, 0.7F);
  EXPECT_TRUE(sets.points[1].accepted);
  // The remaining candidate may now be taken by the geometry.
  EXPECT_EQ(accept_epipolar(sets, rows_geometry(), 10, 0.5).accepted, 1);
}

}  // namespace
}  // namespace corvid
