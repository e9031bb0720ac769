#include "apps/match_picture.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <vector>

namespace corvid {
namespace {

using Points = std::vector<Eigen::Vector2d>;

// Points on a grid, each matched to the same place of the other image.
PairMatches still_matches(Points& points, int width_px, int height_px) {
  PairMatches pair;
  pair.F = Eigen::Matrix3d::Identity();
  for (int y = 20; y < height_px - 20; y += 30) {
    for (int x = 20; x < width_px - 20; x += 30) {
      const Eigen::Vector2d p(x + 0.3, y - 0.2);
      pair.matches.push_back(
          {points.size(), p, p, 0.9F, Eigen::Matrix2d::Identity(), Eigen::Matrix2d::Identity()});
      points.push_back(p);
    }
  }
  return pair;
}

ColourImage draw(const GreyImage& a, const GreyImage& b, const Points& points,
                 const PairMatches& pair, MatchMarks marks = MatchMarks::markers) {
  return match_picture({a, "a"}, {b, "b"}, points, pair, marks);
}

long count(const ColourImage& image, Rgb8 colour) {
  return std::count(image.data(), image.data() + image.size(), colour);
}

bool same_pixels(const ColourImage& image, int x, int y, int dx, int width, int height) {
  for (int v = y; v < y + height; ++v) {
    if (!std::equal(&image(x, v), &image(x, v) + width, &image(x + dx, v))) return false;
  }
  return true;
}

TEST(MatchPicture, AMatchHasTheSameMarkerOnBothImages) {
  const GreyImage grey(400, 300, 120);
  Points points;
  const PairMatches pair = still_matches(points, 400, 300);
  const ColourImage picture = draw(grey, grey, points, pair);
  // Both images are drawn at twice their size; between them lies a gap.
  int shift = 0;
  for (int dx = 800; dx < 850 && shift == 0; ++dx) {
    if (same_pixels(picture, 60, 100, dx, 700, 400)) shift = dx;
  }
  EXPECT_GT(shift, 800) << "the right half does not repeat the left one";
  EXPECT_EQ(picture, draw(grey, grey, points, pair)) << "not the same a second time";

  // Neighbours differ: the markers are not all one.
  bool repeats = true;
  for (int k = 0; k < 6; ++k)
    repeats = repeats && same_pixels(picture, 60 + 60 * k, 100, 60, 55, 50);
  EXPECT_FALSE(repeats);
}

TEST(MatchPicture, EveryReasonHasItsColourOnTheImages) {
  const GreyImage grey(400, 300, 120);
  const Points points = {{200, 150}};
  for (const NoMatchKind& kind : kNoMatchKinds) {
    PairMatches without, with;
    without.F = with.F = Eigen::Matrix3d::Identity();
    with.unmatched.push_back({0, kind.reason, {}});
    const long legend = count(draw(grey, grey, points, without), kind.colour);
    const long one = count(draw(grey, grey, points, with), kind.colour);
    EXPECT_GT(legend, 0) << kind.key;
    EXPECT_GT(one, legend) << kind.key;
    with.unmatched.front().candidates = {{100, 100}, {300, 100}};
    EXPECT_GE(count(draw(grey, grey, points, with), kind.colour) - one, 2 * (one - legend) - 4)
        << kind.key << ": a dot for each candidate";
    EXPECT_EQ(count_reasons(with)[static_cast<std::size_t>(&kind - kNoMatchKinds.data())], 1);
  }
}

TEST(MatchPicture, LinesJoinTheImages) {
  const GreyImage grey(400, 300, 120);
  Points points;
  const PairMatches pair = still_matches(points, 400, 300);
  const ColourImage lines = draw(grey, grey, points, pair, MatchMarks::lines);
  const ColourImage markers = draw(grey, grey, points, pair);
  // The gap between the images is crossed by lines only.
  const int middle = lines.width() / 2;
  int crossed = 0, marked = 0;
  for (int y = 60; y < 560; ++y) {
    if (!(lines(middle, y) == lines(middle, 2))) ++crossed;
    if (!(markers(middle, y) == markers(middle, 2))) ++marked;
  }
  EXPECT_GE(crossed, 9) << "one line for each row of points";
  EXPECT_EQ(marked, 0);
}

TEST(MatchPicture, FitsAPage) {
  struct Case {
    int width_px, height_px;
  };
  for (const Case& c : {Case{752, 480}, {3072, 2048}, {1241, 376}, {200, 3000}, {32, 32}, {1, 1}}) {
    const GreyImage grey(c.width_px, c.height_px, 120);
    const ColourImage picture = draw(grey, grey, {}, {});
    EXPECT_GE(picture.width(), 960) << c.width_px;
    EXPECT_LE(picture.width(), 2400) << c.width_px;
    EXPECT_LE(picture.height(), 2600) << c.width_px;
  }
  const GreyImage wide(1241, 376, 120), narrow(752, 480, 120);
  const ColourImage above = draw(wide, wide, {}, {}), beside = draw(narrow, narrow, {}, {});
  EXPECT_LT(above.width(), 2 * above.height()) << "wide images lie one above the other";
  EXPECT_GT(beside.width(), 2 * beside.height());
}

TEST(MatchPicture, MarksThatLieNowhereAreLeftOut) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const GreyImage a(400, 300, 120), b(160, 333, 90);
  PairMatches pair;
  pair.refusal = "only 3 features of the coarse images agree";
  for (const Eigen::Vector2d& p : {Eigen::Vector2d(nan, 5), {1e300, 5}, {-1e9, 5}, {5, 1e9}}) {
    pair.matches.push_back(
        {0, p, p, 0.9F, Eigen::Matrix2d::Identity(), Eigen::Matrix2d::Identity()});
    pair.unmatched.push_back({7, NoMatch::ambiguous, {p}});
  }
  const Points points = {{nan, nan}};
  for (const MatchMarks marks : {MatchMarks::markers, MatchMarks::lines}) {
    const ColourImage picture = draw(a, b, points, pair, marks);
    EXPECT_GT(picture.width(), 960);
    EXPECT_GT(picture.height(), 2 * 333);
  }
}

}  // namespace
}  // namespace corvid
