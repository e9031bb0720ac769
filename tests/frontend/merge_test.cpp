#include "frontend/merge.h"

#include <gtest/gtest.h>

namespace corvid {
namespace {

using Points = std::vector<Eigen::Vector2d>;
using Indices = std::vector<std::size_t>;

TEST(Duplicates, TheOlderOfTwoOnOneFeatureLives) {
  const Points pixels{{10, 10}, {50, 50}, {10.9, 10.8}, {49.2, 50.5}, {52, 50}};
  const Points still(pixels.size(), {3, 1});
  EXPECT_EQ(find_duplicates(pixels, still, 1.5), (Indices{2, 3}));
}

TEST(Duplicates, TracksThatPassEachOtherStay) {
  EXPECT_TRUE(find_duplicates(Points{{10, 10}, {10.5, 10}}, Points{{3, 0}, {-2, 0}}, 1.5).empty());
}

TEST(Duplicates, AreFoundAcrossCellsAndBelowZero) {
  for (const Eigen::Vector2d& at : {Eigen::Vector2d(3, 3), {-3, -1.5}, {0, 0}})
    for (const Eigen::Vector2d& off : {Eigen::Vector2d(-1.4, 0), {1.4, 0}, {0, 1.4}, {-1, -1}})
      EXPECT_EQ(find_duplicates(Points{at, at + off}, Points(2, {0, 0}), 1.5), Indices{1});
}

TEST(Duplicates, OfAChainEverySecondIsTooNearToOneThatLives) {
  const Points pixels{{0, 0}, {1, 0}, {2, 0}, {3, 0}};
  EXPECT_EQ(find_duplicates(pixels, Points(4, {0, 0}), 1.5), (Indices{1, 3}));
}

TEST(Duplicates, OfNothingAreNone) { EXPECT_TRUE(find_duplicates({}, {}, 1.5).empty()); }

TEST(Duplicates, GoByThePlacesAloneWhereThereAreNoVelocities) {
  EXPECT_EQ(find_duplicates(Points{{10, 10}, {11, 10}, {20, 10}, {10.2, 9.5}}, {}, 1.5),
            (Indices{1, 3}));
}

}  // namespace
}  // namespace corvid
