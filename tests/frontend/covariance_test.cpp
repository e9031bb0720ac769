#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <map>
#include <numbers>
#include <random>

#include "frontend/frontend.h"
#include "frontend/frontend_scenes.h"

namespace corvid {
namespace {

using test::device;

TEST(PeakCovariance, ItsAxesAreThoseOfThePeak) {
  NccPeak peak;
  peak.score = 0.96F;
  // Curvature 0.4 at 30 degrees, 0.05 across.
  const double a = std::numbers::pi / 6;
  const Eigen::Vector2d strong(std::cos(a), std::sin(a)), weak(-std::sin(a), std::cos(a));
  const Eigen::Matrix2d H = -0.4 * strong * strong.transpose() - 0.05 * weak * weak.transpose();
  peak.cxx = static_cast<float>(H(0, 0));
  peak.cxy = static_cast<float>(H(0, 1));
  peak.cyy = static_cast<float>(H(1, 1));
  const Eigen::Matrix2d covariance_px2 = peak_covariance_px2(peak);
  EXPECT_NEAR(strong.dot(covariance_px2 * strong), 0.02 / 0.4, 1e-4);
  EXPECT_NEAR(weak.dot(covariance_px2 * weak), 0.02 / 0.05, 1e-4);
  EXPECT_NEAR(strong.dot(covariance_px2 * weak), 0, 1e-4);
  EXPECT_NEAR(largest_sigma_px(covariance_px2), std::sqrt(0.4), 1e-4);
}

TEST(PeakCovariance, IsBoundedWhateverThePeak) {
  for (const float score : {-1.0F, 0.0F, 0.9F, 1.0F})
    for (const float c : {0.0F, -1e-9F, -1e9F}) {
      const Eigen::Matrix2d covariance_px2 = peak_covariance_px2({5, 5, score, c, 0, c});
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(covariance_px2);
      EXPECT_GE(eigen.eigenvalues()(0), 0.1 * 0.1 - 1e-9);
      EXPECT_LE(eigen.eigenvalues()(1), 4.0 * 4.0 + 1e-9);
    }
}

TEST(PeakCovariance, AnEdgeIsUncertainAlongTheEdge) {
  auto pyramids = PyramidBuilder::create(device());
  auto matcher = NccMatcher::create(device());
  ASSERT_TRUE(pyramids && matcher);
  constexpr double kTurn = 25 * std::numbers::pi / 180;
  const Eigen::Vector2d along(std::cos(kTurn), std::sin(kTurn)), across(-along.y(), along.x());
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0, 2);
  // A soft step across the edge, and along it just enough change that there is a peak.
  const auto view = [&] {
    GreyImage image(120, 120);
    for (int y = 0; y < 120; ++y)
      for (int x = 0; x < 120; ++x) {
        const Eigen::Vector2d d(x - 60, y - 60);
        const double value = 128 + 70 * std::tanh(d.dot(across) / 1.5) +
                             30 * std::cos(d.dot(along) / 4) + noise(random);
        image(x, y) = static_cast<std::uint8_t>(std::clamp(value, 0.0, 255.0));
      }
    return image;
  };
  const auto anchor = pyramids->build(view(), 1);
  const auto target = pyramids->build(view(), 1);
  TrackSearch search(*matcher, 11, 0.85);
  SearchQuery query;
  query.anchor = anchor;
  query.anchor_px = query.predicted_px = {60, 60};
  const auto found = search.track(*target, std::vector{query}, {0, 6, 6});
  ASSERT_GT(found[0].score, 0.8F);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(found[0].covariance_px2);
  EXPECT_GT(std::abs(eigen.eigenvectors().col(1).dot(along)), std::cos(0.2));
  EXPECT_GT(eigen.eigenvalues()(1), 4 * eigen.eigenvalues()(0));
}

// d^T C^-1 d has the mean 2 if the covariance is right. Gross errors, which no covariance means to
// cover, are left out by a limit that a right one nearly never reaches.
TEST(PeakCovariance, SaysHowFarMatchesOfAFlightAreOff) {
  const SyntheticFlight flight(test::small_flight());
  FrontendOptions options;
  options.max_tracks = 400;
  auto frontend = Frontend::create(device(), options, false);
  ASSERT_TRUE(frontend) << frontend.error().to_string();
  std::map<TrackId, std::pair<std::size_t, Eigen::Vector2d>> births;
  std::map<std::size_t, FloatImage> depths;
  std::vector<double> normalised, fresh_normalised, aged_normalised;
  int gross = 0;
  for (std::size_t i = 0; i < 40; ++i) {
    for (const auto& o : (*frontend)->process(flight.render(i), nullptr).observations) {
      const auto [birth, fresh] = births.try_emplace(o.track, i, o.pixel);
      const auto& [first, first_px] = birth->second;
      if (fresh) {
        if (!depths.contains(i)) depths[i] = flight.render_depth(i);
        continue;
      }
      const auto x = test::true_place(flight, flight.true_pose(first), depths[first], first_px,
                                      flight.true_pose(i));
      if (!x) continue;
      const Eigen::Vector2d d = o.pixel - *x;
      const double squared = d.dot(o.covariance_px2.inverse() * d);
      if (d.norm() > 3) {
        ++gross;
        continue;
      }
      normalised.push_back(squared);
      (i - first <= 5 ? fresh_normalised : aged_normalised).push_back(squared);
    }
  }
  const auto mean = [](const std::vector<double>& values) {
    double sum = 0;
    for (const double v : values) sum += v;
    return sum / static_cast<double>(values.size());
  };
  ASSERT_GE(normalised.size(), 3000U);
  std::printf("mean %.2f (young %.2f, old %.2f), median %.2f, 95 %% %.2f of %zu; %d gross\n",
              mean(normalised), mean(fresh_normalised), mean(aged_normalised),
              test::quantile(normalised, 0.5), test::quantile(normalised, 0.95), normalised.size(),
              gross);
  EXPECT_GT(mean(normalised), 0.5);
  EXPECT_LT(mean(normalised), 4);
  EXPECT_GT(mean(fresh_normalised), 0.5);
  EXPECT_LT(mean(aged_normalised), 4);
  EXPECT_LT(gross, static_cast<int>(normalised.size() / 50));
}

}  // namespace
}  // namespace corvid
