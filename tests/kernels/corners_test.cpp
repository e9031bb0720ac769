#include "kernels/corners.h"

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <tuple>

#include "kernels/test_device.h"
#include "kernels/textures.h"
#include "oracle/corners.h"

namespace corvid {
namespace {

constexpr double kKappa = 0.04;
constexpr int kReach = 4;
constexpr KernelKind kKinds[] = {KernelKind::cpu, KernelKind::gpu};

// Largest difference of the score images to the oracle, relative to the scale of the scores.
double worst_difference(CornerDetector& detector, const GreyImage& image) {
  const CornerScoreImages scores = detector.scores(upload(*test_device(), image), kKappa);
  double worst = 0, scale = 1e-3;
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x) {
      if (!image.contains(x, y, kReach)) {
        EXPECT_EQ(scores.lambda_min(x, y), 0);
        EXPECT_EQ(scores.harris(x, y), 0);
        continue;
      }
      const auto wanted = oracle::corner_score(image, x, y, kKappa);
      scale = std::max(scale, wanted.lambda_min);
      worst = std::max({worst, std::abs(wanted.lambda_min - scores.lambda_min(x, y)),
                        // det is of the order of lambda squared: compare roots.
                        std::abs(std::cbrt(wanted.harris) - std::cbrt(scores.harris(x, y))) *
                            (std::abs(wanted.harris) > 1 ? 1. : 0.)});
    }
  return worst / scale;
}

TEST(Corners, ScoresAgreeWithTheOracle) {
  for (const KernelKind kind : kKinds) {
    auto detector = make<CornerDetector>("", kind);
    for (const auto& [width, height] :
         {std::pair{133, 97}, {64, 40}, {17, 50}, {9, 9}, {300, 70}, {144, 129}})
      for (const auto& [name, image] : test_images(width, height))
        EXPECT_LT(worst_difference(detector, image), 1e-3) << name << " " << width;
  }
}

TEST(Corners, APlantedFaultIsFound) {
  for (const KernelKind kind : kKinds) {
    auto detector = make<CornerDetector>("-DCORVID_PLANT_FAULT", kind);
    for (const auto& [name, image] : test_images(133, 97)) {
      if (name == "ramp") continue;  // its scores are nearly zero
      EXPECT_GT(worst_difference(detector, image), 1e-3) << name;
    }
  }
}

class CornersOfKind : public ::testing::TestWithParam<KernelKind> {};

TEST_P(CornersOfKind, AreTheStrictMaximaThatTheOracleFinds) {
  auto detector = make<CornerDetector>("", GetParam());
  for (const auto& [name, image] : test_images(133, 97)) {
    Image<double> lambda(image.width(), image.height());
    double largest = 0;
    for (int y = kReach; y < image.height() - kReach; ++y)
      for (int x = kReach; x < image.width() - kReach; ++x) {
        lambda(x, y) = oracle::corner_score(image, x, y, kKappa).lambda_min;
        largest = std::max(largest, lambda(x, y));
      }
    if (largest < 0.01) continue;  // nothing but rounding
    // Sure ones must be found, and what is found must not be surely wrong: rounding decides
    // between.
    const double slack = 1e-4 * largest;
    std::set<std::pair<int, int>> sure, possible;
    for (int y = kCornerMargin_px; y < image.height() - kCornerMargin_px; ++y)
      for (int x = kCornerMargin_px; x < image.width() - kCornerMargin_px; ++x) {
        double around = 0;
        for (int j = -1; j <= 1; ++j)
          for (int i = -1; i <= 1; ++i)
            if (i != 0 || j != 0) around = std::max(around, lambda(x + i, y + j));
        const double harris = oracle::corner_score(image, x, y, kKappa).harris;
        const double margin = std::min({lambda(x, y) - around, lambda(x, y) - 0.01 * largest,
                                        harris > 0 ? std::sqrt(harris) : -std::sqrt(-harris)});
        if (margin > slack) sure.insert({x, y});
        if (margin > -slack) possible.insert({x, y});
      }
    const auto found = detector.detect_all(upload(*test_device(), image), 0.01, kKappa);
    std::size_t matched = 0;
    for (const Corner& corner : found) {
      // The refined place is within a pixel of its maximum.
      bool known = false;
      for (int j = -1; j <= 2 && !known; ++j)
        for (int i = -1; i <= 2 && !known; ++i) {
          const std::pair at(static_cast<int>(std::floor(corner.x_px)) + i,
                             static_cast<int>(std::floor(corner.y_px)) + j);
          known = possible.contains(at) && std::abs(corner.x_px - at.first) <= 1 &&
                  std::abs(corner.y_px - at.second) <= 1 &&
                  std::abs(corner.lambda_min - lambda(at.first, at.second)) <= slack;
          if (known) matched += sure.contains(at);
        }
      EXPECT_TRUE(known) << name << " " << corner.x_px << " " << corner.y_px;
    }
    EXPECT_GE(matched, sure.size()) << name;
    EXPECT_LE(found.size(), possible.size()) << name;
    if (name == "natural") {
      EXPECT_GT(sure.size(), 30U);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Corners, CornersOfKind, ::testing::ValuesIn(kKinds));

// Both kinds, at every width, and with a border: the same corners, strongest first.
TEST(Corners, OfBothKindsOfKernelAreTheSame) {
  auto cpu = make<CornerDetector>("", KernelKind::cpu);
  auto gpu = make<CornerDetector>("", KernelKind::gpu);
  std::size_t found = 0, unlike = 0;
  for (int width = 11; width < 160; width += 4)
    for (const int border : {0, 9}) {
      const DeviceImage image = upload(*test_device(), noise(width, 170 - width));
      const auto a = cpu.detect_all(image, 0.05, kKappa, border);
      const auto b = gpu.detect_all(image, 0.05, kKappa, border);
      found += a.size();
      if (a.size() != b.size()) {  // by rounding, at the threshold
        ++unlike;
        continue;
      }
      for (std::size_t i = 0; i < a.size(); ++i) {
        const float nearest =
            std::min({a[i].x_px, a[i].y_px, width - 1 - a[i].x_px, 169 - width - a[i].y_px});
        EXPECT_GE(nearest, std::max(border, kCornerMargin_px) - 1);
        if (i > 0) {
          EXPECT_LE(a[i].lambda_min, a[i - 1].lambda_min);
        }
        // In the same order but for those of nearly the same strength.
        EXPECT_NEAR(a[i].lambda_min, b[i].lambda_min, 1e-4 * a[0].lambda_min);
        const auto twin = std::find_if(b.begin(), b.end(), [&](const Corner& other) {
          return std::abs(other.x_px - a[i].x_px) < 0.01F &&
                 std::abs(other.y_px - a[i].y_px) < 0.01F &&
                 std::abs(other.harris - a[i].harris) <= 1e-3F * std::abs(a[0].harris);
        });
        EXPECT_NE(twin, b.end()) << a[i].x_px << " " << a[i].y_px;
      }
    }
  EXPECT_GT(found, 1000U);
  EXPECT_LE(unlike, 2U);
}

// Equal ones by their places, whatever order the device found them in.
TEST(Corners, OfEqualStrengthAreOrderedByPlace) {
  auto detector = make<CornerDetector>();
  const GreyImage tile = noise(24, 20);
  const GreyImage image =
      paint(240, 200, [&](int x, int y) { return tile(x % tile.width(), y % tile.height()); });
  const auto corners = detector.detect_all(upload(*test_device(), image), 0.01, kKappa);
  ASSERT_GT(corners.size(), 500U);
  std::size_t equal = 0;
  for (std::size_t i = 1; i < corners.size(); ++i) {
    const Corner &a = corners[i - 1], &b = corners[i];
    ASSERT_GE(a.lambda_min, b.lambda_min);
    if (a.lambda_min != b.lambda_min) continue;
    ++equal;
    EXPECT_LT(std::tuple(a.y_px, a.x_px), std::tuple(b.y_px, b.x_px));
  }
  EXPECT_GT(equal, 300U);
}

TEST(Corners, AreFoundInGreyImagesOnly) {
  auto detector = make<CornerDetector>();
  const DeviceImage image = upload(*test_device(), FloatImage(40, 40));
  EXPECT_THROW((void)detector.detect(image, {}), std::logic_error);
  EXPECT_THROW((void)detector.score_at(image, std::vector<Eigen::Vector2f>{{9, 9}}, kKappa),
               std::logic_error);
}

TEST(Corners, ScoresAtPointsAreThoseOfTheImages) {
  auto detector = make<CornerDetector>();
  const GreyImage image = test_images(120, 90)[0].second;
  const DeviceImage on_device = upload(*test_device(), image);
  const CornerScoreImages all = detector.scores(on_device, kKappa);
  std::vector<Eigen::Vector2f> points;
  for (int y = 0; y < 90; y += 3)
    for (int x = 0; x < 120; x += 5) points.emplace_back(x + 0.3F, y - 0.4F);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float inf = std::numeric_limits<float>::infinity();
  for (const Eigen::Vector2f& p : {Eigen::Vector2f(nan, 20),
                                   {20, nan},
                                   {inf, 20},
                                   {20, -inf},
                                   {-1e30F, 20},
                                   {3.4F, 20},
                                   {116.4F, 50}})
    points.push_back(p);
  const auto scores = detector.score_at(on_device, points, kKappa);
  ASSERT_EQ(scores.size(), points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    CornerScore wanted;
    if (points[i].allFinite() && points[i].cwiseAbs().maxCoeff() < 1e6F) {
      const int x = static_cast<int>(std::lround(points[i].x()));
      const int y = static_cast<int>(std::lround(points[i].y()));
      if (image.contains(x, y)) wanted = {all.lambda_min(x, y), all.harris(x, y)};
    }
    const float scale = std::max(1.F, wanted.lambda_min);
    EXPECT_NEAR(scores[i].lambda_min, wanted.lambda_min, 1e-4 * scale) << points[i].transpose();
    EXPECT_NEAR(scores[i].harris, wanted.harris, 1e-3 * scale * scale) << points[i].transpose();
  }
  EXPECT_TRUE(detector.score_at(on_device, {}, kKappa).empty());
}

TEST(Corners, OfASquareAreRefined) {
  auto detector = make<CornerDetector>();
  // A blurred bright square with its corners at (30.3, 20.6) + {0, 25}.
  const auto edge = [](double d) { return 1 / (1 + std::exp(-2 * d)); };
  const GreyImage image = paint(90, 70, [&](int x, int y) {
    return 40 + 180 * edge(x - 30.3) * edge(55.3 - x) * edge(y - 20.6) * edge(45.6 - y);
  });
  const auto corners = detector.detect_all(upload(*test_device(), image), 0.2, kKappa);
  ASSERT_EQ(corners.size(), 4U);
  for (const Corner& corner : corners) {
    // The maximum lies inside the corner by symmetry alike in all four: compare their distances.
    EXPECT_NEAR(std::abs(corner.x_px - 42.8), 12.5, 1.5);
    EXPECT_NEAR(std::abs(corner.y_px - 33.1), 12.5, 1.5);
    EXPECT_NEAR(std::abs(corner.x_px - 42.8), std::abs(corners[0].x_px - 42.8), 0.2);
    EXPECT_NEAR(std::abs(corner.y_px - 33.1), std::abs(corners[0].y_px - 33.1), 0.2);
    EXPECT_GT(corner.harris, 0);
  }
}

TEST(Corners, ImagesWithoutCornersGiveNone) {
  auto detector = make<CornerDetector>();
  const auto count = [&](const GreyImage& image) {
    return detector.detect(upload(*test_device(), image), {}).size();
  };
  EXPECT_EQ(count(GreyImage(80, 60, 255)), 0U);
  EXPECT_EQ(count(GreyImage(1, 1, 9)), 0U);
  EXPECT_EQ(count(noise(10, 400)), 0U);
  EXPECT_EQ(count(paint(80, 60, [](int x, int) { return x < 40 ? 20 : 220; })), 0U);
  EXPECT_GT(count(noise(80, 60)), 10U);
}

TEST(Corners, AreTheSameInEveryRun) {
  auto detector = make<CornerDetector>();
  const DeviceImage image = upload(*test_device(), noise(300, 200));
  const auto first = detector.detect(image, {});
  ASSERT_GT(first.size(), 100U);
  for (int run = 0; run < 5; ++run) {
    const auto again = detector.detect(image, {});
    ASSERT_EQ(again.size(), first.size());
    for (std::size_t i = 0; i < first.size(); ++i) {
      EXPECT_EQ(again[i].x_px, first[i].x_px);
      EXPECT_EQ(again[i].y_px, first[i].y_px);
      EXPECT_EQ(again[i].lambda_min, first[i].lambda_min);
    }
  }
}

std::vector<Corner> random_corners(std::size_t count) {
  std::mt19937 random(3);
  std::vector<Corner> corners;
  for (std::size_t i = 0; i < count; ++i)
    corners.push_back({static_cast<float>(random() % 6400) / 10,
                       static_cast<float>(random() % 4800) / 10, static_cast<float>(count - i), 1});
  return corners;
}

TEST(SelectEvenly, KeepsItsPromises) {
  const auto corners = random_corners(4000);
  CornerOptions options;
  options.cell_px = 40;
  options.max_per_cell = 3;
  options.max_count = 400;
  options.min_distance_px = 6;
  std::vector<Eigen::Vector2f> occupied;
  for (int i = 0; i < 50; ++i) occupied.emplace_back(i * 12.F, 100.F);
  options.occupied = occupied;
  const auto selected = select_evenly(corners, options);
  EXPECT_GT(selected.size(), 250U);
  EXPECT_LE(selected.size(), 400U);
  std::map<std::pair<int, int>, int> cells;
  for (const auto& p : occupied)
    ++cells[{static_cast<int>(p.x() / 40), static_cast<int>(p.y() / 40)}];
  const auto crowded = cells;
  for (std::size_t i = 0; i < selected.size(); ++i) {
    const std::pair cell(static_cast<int>(selected[i].x_px / 40),
                         static_cast<int>(selected[i].y_px / 40));
    EXPECT_LE(++cells[cell], 3);
    EXPECT_FALSE(crowded.contains(cell) && crowded.at(cell) >= 3);
    for (std::size_t k = 0; k < i; ++k)
      EXPECT_GE(
          std::hypot(selected[i].x_px - selected[k].x_px, selected[i].y_px - selected[k].y_px),
          6 - 1e-4);
    for (const auto& p : occupied)
      EXPECT_GE(std::hypot(selected[i].x_px - p.x(), selected[i].y_px - p.y()), 6 - 1e-4);
  }
}

TEST(SelectEvenly, TakesTheBestOfEachCellFirst) {
  const auto corners = random_corners(2000);
  CornerOptions options;
  options.cell_px = 160;  // 4 x 3 cells
  options.max_per_cell = 50;
  options.max_count = 12;
  options.min_distance_px = 0;
  const auto selected = select_evenly(corners, options);
  std::map<std::pair<int, int>, float> best;
  const auto cell = [](const Corner& c) {
    return std::pair(static_cast<int>(c.x_px / 160), static_cast<int>(c.y_px / 160));
  };
  for (const Corner& c : corners) best[cell(c)] = std::max(best[cell(c)], c.lambda_min);
  ASSERT_EQ(selected.size(), 12U);
  for (const Corner& c : selected) EXPECT_EQ(c.lambda_min, best.at(cell(c)));
}

TEST(SelectEvenly, TakesHostileInput) {
  const auto corners = random_corners(100);
  CornerOptions options;
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::vector<Eigen::Vector2f> occupied{{nan, 3}, {1e30F, -1e30F}};
  options.occupied = occupied;
  EXPECT_FALSE(select_evenly(corners, options).empty());
  EXPECT_TRUE(select_evenly({}, options).empty());
  // Far from each other, and kept apart by more and by less than that.
  const std::vector<Corner> far{{-9e5F, 0, 3, 1}, {9e5F, 9e5F, 2, 1}, {9e5F, 0, 1, 1}};
  for (const double distance : {0., 1e-9, 4., 1e5}) {
    options.min_distance_px = distance;
    EXPECT_EQ(select_evenly(far, options).size(), 3U) << distance;
  }
  options.min_distance_px = HUGE_VAL;
  EXPECT_EQ(select_evenly(far, options).size(), 1U);
  options.min_distance_px = 4;
  const std::vector<Corner> nowhere{{nan, 0, 3, 1}};
  EXPECT_THROW((void)select_evenly(nowhere, options), std::logic_error);
  options.max_count = 0;
  EXPECT_TRUE(select_evenly(corners, options).empty());
  options.max_count = -5;
  EXPECT_TRUE(select_evenly(corners, options).empty());
  options.cell_px = 0;
  EXPECT_THROW((void)select_evenly(corners, options), std::logic_error);
}

}  // namespace
}  // namespace corvid
