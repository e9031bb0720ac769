#include "frontend/pair_matcher.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <future>
#include <map>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <random>

#include "frontend/epipolar.h"
#include "frontend/frontend_scenes.h"

namespace corvid {
namespace {

using test::device;
using test::TruthErrors;

std::unique_ptr<PairMatcher> make_matcher(const MatchingOptions& options = {}) {
  auto matcher = PairMatcher::create(device(), options);
  if (!matcher) throw std::runtime_error(matcher.error().to_string());
  return std::move(*matcher);
}

std::unique_ptr<SyntheticFlight> make_flight(FlightPath path = FlightPath::survey) {
  FlightOptions options = test::small_flight();
  options.duration_s = FlightOptions().duration_s;
  options.path = path;
  return std::make_unique<SyntheticFlight>(options);
}

cv::Mat view_of(const GreyImage& image) {
  return {image.height(), image.width(), CV_8U, const_cast<std::uint8_t*>(image.data())};
}

GreyImage grey_of(const cv::Mat& mat) {
  GreyImage image(mat.cols, mat.rows);
  mat.copyTo(cv::Mat(mat.rows, mat.cols, CV_8U, image.data()));
  return image;
}

void add_matches(TruthErrors& errors, const SyntheticFlight& flight, const Pose& T_world_r,
                 const Pose& T_world_t, const PairMatches& matches) {
  const FloatImage depth = flight.render_depth(T_world_r);
  for (const PairMatch& match : matches.matches)
    errors.add(flight, T_world_r, depth, match.x_r, T_world_t, match.x_t);
}

/// Every point of the reference is a match or has a reason not to be, once.
void expect_complete(const MatchView& reference, const PairMatches& result) {
  std::vector<int> seen(reference.points.size(), 0);
  for (const PairMatch& match : result.matches) ++seen.at(match.point);
  for (const UnmatchedPoint& point : result.unmatched) ++seen.at(point.point);
  EXPECT_TRUE(std::all_of(seen.begin(), seen.end(), [](int n) { return n == 1; }));
  EXPECT_EQ(result.F.has_value(), result.refusal.empty());
}

PairMatches match_images(PairMatcher& matcher, const GreyImage& a, const GreyImage& b,
                         const Camera& camera, const PairKnowledge& known = {}) {
  const MatchView reference = matcher.prepare(a, camera), target = matcher.prepare(b, camera);
  PairMatches result = matcher.match(reference, target, known);
  expect_complete(reference, result);
  return result;
}

TEST(PairMatcher, FindsManyExactMatchesBetweenFramesOfAFlight) {
  const auto flight = make_flight();
  const auto matcher = make_matcher();
  TruthErrors errors;
  std::size_t matches = 0;
  for (std::size_t i : {0U, 60U, 120U}) {
    const auto a = flight->render(i), b = flight->render(i + 4);
    const auto result = match_images(*matcher, a->grey, b->grey, flight->camera());
    ASSERT_TRUE(result.F) << result.refusal;
    add_matches(errors, *flight, flight->true_pose(i), flight->true_pose(i + 4), result);
    matches += result.matches.size();
    for (const PairMatch& match : result.matches) {
      EXPECT_LE(sampson_distance_px(*result.F, match.x_r, match.x_t), 0.2 + 1e-9);
      EXPECT_TRUE(match.covariance_px2.allFinite());
      EXPECT_GT(match.covariance_px2.determinant(), 0);
    }
  }
  EXPECT_GT(matches, 3 * 1200U);
  EXPECT_LT(errors.quantile(0.5), 0.08);
  EXPECT_LT(errors.share_above(3), 0.002);
}

TEST(PairMatcher, SaysWhereTheCandidatesWereThatItRefused) {
  const auto flight = make_flight(FlightPath::facade);
  const auto result = match_images(*make_matcher(), flight->render(0)->grey,
                                   flight->render(6)->grey, flight->camera());
  ASSERT_TRUE(result.F) << result.refusal;
  std::map<NoMatch, int> counts;
  for (const UnmatchedPoint& point : result.unmatched) {
    ++counts[point.reason];
    EXPECT_EQ(point.candidates.empty(), point.reason == NoMatch::no_candidate)
        << static_cast<int>(point.reason);
    for (const Eigen::Vector2d& candidate : point.candidates)
      EXPECT_TRUE(flight->camera().in_image(candidate));
  }
  EXPECT_GT(counts[NoMatch::geometry], 0);
  EXPECT_GT(counts[NoMatch::weak_corner], 0);
  EXPECT_GT(counts[NoMatch::low_score], 0);
}

TEST(PairMatcher, RepeatsItselfBitForBit) {
  const auto flight = make_flight();
  const auto matcher = make_matcher();
  const auto a = flight->render(10), b = flight->render(14);
  const auto one = match_images(*matcher, a->grey, b->grey, flight->camera());
  const auto two = match_images(*make_matcher(), a->grey, b->grey, flight->camera());
  ASSERT_EQ(one.matches.size(), two.matches.size());
  for (std::size_t i = 0; i < one.matches.size(); ++i)
    ASSERT_EQ(one.matches[i].x_t, two.matches[i].x_t);
}

struct Turn {
  double angle_deg, scale;
};
class PairMatcherTurns : public testing::TestWithParam<Turn> {};

TEST_P(PairMatcherTurns, AreSurvived) {
  const auto flight = make_flight();
  const auto matcher = make_matcher();
  const auto a = flight->render(30), b = flight->render(33);
  const Camera& camera = flight->camera();
  const cv::Mat turn = cv::getRotationMatrix2D(
      {static_cast<float>(camera.width_px) / 2, static_cast<float>(camera.height_px) / 2},
      GetParam().angle_deg, GetParam().scale);
  cv::Mat turned;
  cv::warpAffine(view_of(b->grey), turned, turn, {camera.width_px, camera.height_px},
                 GetParam().scale < 1 ? cv::INTER_AREA : cv::INTER_CUBIC);
  auto result = match_images(*matcher, a->grey, grey_of(turned), camera);
  ASSERT_TRUE(result.F) << result.refusal;
  EXPECT_GT(result.matches.size(), 250U);
  Eigen::Matrix<double, 2, 3> A;
  for (int r = 0; r < 2; ++r)
    for (int c = 0; c < 3; ++c) A(r, c) = turn.at<double>(r, c);
  const Eigen::Matrix2d back = A.leftCols<2>().inverse();
  for (PairMatch& match : result.matches) match.x_t = back * (match.x_t - A.col(2));
  TruthErrors errors;
  add_matches(errors, *flight, flight->true_pose(30), flight->true_pose(33), result);
  EXPECT_LT(errors.quantile(0.5) * GetParam().scale, 0.2);
  EXPECT_LT(errors.share_above(3), 0.01);
}

INSTANTIATE_TEST_SUITE_P(Pairs, PairMatcherTurns,
                         testing::Values(Turn{15, 1}, Turn{45, 1}, Turn{90, 1}, Turn{180, 1},
                                         Turn{0, 0.7}, Turn{0, 1.4}, Turn{30, 0.8}),
                         [](const auto& turn) {
                           return "by" + std::to_string(static_cast<int>(turn.param.angle_deg)) +
                                  "scale" + std::to_string(static_cast<int>(10 * turn.param.scale));
                         });

GreyImage noise(int width, int height, unsigned seed) {
  std::mt19937 random(seed);
  GreyImage image(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) image(x, y) = static_cast<std::uint8_t>(random() % 256);
  return image;
}

// While the lane of tracking is held, a pair of the other lane is matched, turned images included.
TEST(PairMatcher, LaunchesNothingInAnotherLane) {
  const auto flight = make_flight();
  const auto made = PairMatcher::create(device(), {}, Lane::mapping);
  ASSERT_TRUE(made.has_value());
  const auto a = flight->render(30), b = flight->render(33);
  cv::Mat upside_down;
  cv::rotate(view_of(b->grey), upside_down, cv::ROTATE_180);
  const GreyImage turned = grey_of(upside_down);
  cl::UserEvent go(device()->context());
  const std::vector<cl::Event> wait{go};
  device()->queue(Lane::tracking).enqueueBarrierWithWaitList(&wait);
  device()->queue(Lane::tracking).flush();
  auto matched = std::async(
      std::launch::async, [&] { return match_images(**made, a->grey, turned, flight->camera()); });
  const bool free = matched.wait_for(std::chrono::minutes(2)) == std::future_status::ready;
  go.setStatus(CL_COMPLETE);
  EXPECT_TRUE(free) << "it waits for the lane of tracking";
  EXPECT_TRUE(matched.get().F);
}

TEST(PairMatcher, GivesNothingWhereThereIsNothingInCommon) {
  const auto flight = make_flight();
  const Camera& camera = flight->camera();
  const auto matcher = make_matcher();
  const GreyImage seen = flight->render(0)->grey;
  GreyImage black(camera.width_px, camera.height_px);
  view_of(black).setTo(0);
  cv::Mat smooth_a, smooth_b;
  cv::GaussianBlur(view_of(noise(camera.width_px, camera.height_px, 3)), smooth_a, {}, 2);
  cv::GaussianBlur(view_of(noise(camera.width_px, camera.height_px, 4)), smooth_b, {}, 2);
  const std::vector<std::pair<GreyImage, GreyImage>> pairs{
      {black, black},
      {seen, black},
      {black, seen},
      {seen, noise(camera.width_px, camera.height_px, 1)},
      {noise(camera.width_px, camera.height_px, 1), noise(camera.width_px, camera.height_px, 2)},
      {grey_of(smooth_a), grey_of(smooth_b)},
      {seen, grey_of(smooth_a)},
  };
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const auto result = match_images(*matcher, pairs[i].first, pairs[i].second, camera);
    EXPECT_FALSE(result.F) << "pair " << i << ": " << result.matches.size() << " matches";
    EXPECT_TRUE(result.matches.empty());
    EXPECT_FALSE(result.refusal.empty());
  }
}

TEST(PairMatcher, GivesNothingForViewsWithoutOverlap) {
  const auto flight = make_flight();
  const auto matcher = make_matcher();
  // The ground looked at from places far apart: the same kind of texture, another part of it.
  const Pose a = flight->true_pose(0);
  int given = 0;
  for (double shift : {60.0, 90.0, 140.0}) {
    const Pose b(a.rotation(), a.translation() + Eigen::Vector3d(shift, 0.7 * shift, 0));
    const auto result = match_images(*matcher, flight->render(a, 0)->grey,
                                     flight->render(b, 1)->grey, flight->camera());
    if (!result.F) continue;
    // What is given must be true: the far background may really be seen in both.
    TruthErrors errors;
    add_matches(errors, *flight, a, b, result);
    EXPECT_GT(2 * errors.px.size(), result.matches.size());
    EXPECT_LT(errors.share_above(3), 0.05) << shift << ": " << result.matches.size();
    ++given;
  }
  EXPECT_LT(given, 3);
}

TEST(PairMatcher, AbstainsOnASingleRepeatedTexture) {
  const auto matcher = make_matcher();
  Camera camera;
  camera.width_px = 480;
  camera.height_px = 320;
  camera.fx_px = camera.fy_px = 400;
  camera.cx_px = 239.5;
  camera.cy_px = 159.5;
  GreyImage a(480, 320), b(480, 320);
  const auto tile = [](double x, double y) {
    return static_cast<std::uint8_t>(128 +
                                     60 * std::sin(x * 2 * std::numbers::pi / 16) *
                                         std::cos(y * 2 * std::numbers::pi / 16) +
                                     40 * std::cos(x * 2 * std::numbers::pi / 8 + 1));
  };
  for (int y = 0; y < 320; ++y)
    for (int x = 0; x < 480; ++x) {
      a(x, y) = tile(x, y);
      b(x, y) = tile(x + 5.3, y + 2.1);
    }
  const auto result = match_images(*matcher, a, b, camera);
  EXPECT_FALSE(result.F) << result.matches.size();
}

TEST(PairMatcher, FewWrongMatchesOnRepeatedWindows) {
  const auto flight = make_flight(FlightPath::facade);
  const auto matcher = make_matcher();
  TruthErrors errors;
  for (std::size_t i : {0U, 40U, 80U, 120U}) {
    const auto result = match_images(*matcher, flight->render(i)->grey, flight->render(i + 6)->grey,
                                     flight->camera());
    ASSERT_TRUE(result.F) << result.refusal;
    add_matches(errors, *flight, flight->true_pose(i), flight->true_pose(i + 6), result);
  }
  EXPECT_GT(errors.px.size(), 2000U);
  EXPECT_LT(errors.share_above(1), 0.02);
  EXPECT_LT(errors.quantile(0.5), 0.1);
}

TEST(PairMatcher, SurvivesExposureStepsAndVignetting) {
  const auto flight = make_flight();
  const auto matcher = make_matcher();
  const auto a = flight->render(20), b = flight->render(24);
  const auto plain = match_images(*matcher, a->grey, b->grey, flight->camera());
  ASSERT_TRUE(plain.F);
  const auto changed = [&](double gain, double gamma, double vignette) {
    GreyImage image = b->grey;
    const double cx = 0.5 * image.width(), cy = 0.5 * image.height();
    for (int y = 0; y < image.height(); ++y)
      for (int x = 0; x < image.width(); ++x) {
        const double r2 = ((x - cx) * (x - cx) + (y - cy) * (y - cy)) / (cx * cx + cy * cy);
        const double value =
            255 * std::pow(image(x, y) / 255.0, gamma) * gain * (1 - vignette * r2);
        image(x, y) = static_cast<std::uint8_t>(std::clamp(value, 0.0, 255.0));
      }
    return image;
  };
  for (const auto& image : {changed(0.5, 1, 0), changed(1.6, 1, 0), changed(1, 1.5, 0),
                            changed(1, 1, 0.6), changed(0.4, 1.2, 0.5)}) {
    const auto result = match_images(*matcher, a->grey, image, flight->camera());
    ASSERT_TRUE(result.F) << result.refusal;
    EXPECT_GT(result.matches.size(), plain.matches.size() / 2);
    TruthErrors errors;
    add_matches(errors, *flight, flight->true_pose(20), flight->true_pose(24), result);
    EXPECT_LT(errors.quantile(0.5), 0.12);
    EXPECT_LT(errors.share_above(3), 0.005);
  }
}

Eigen::Matrix3d true_fundamental(const Camera& camera, const Pose& T_world_r,
                                 const Pose& T_world_t) {
  const Pose T_t_r = T_world_t.inverse() * T_world_r;
  const Eigen::Vector3d t = T_t_r.translation();
  Eigen::Matrix3d cross;
  cross << 0, -t.z(), t.y(), t.z(), 0, -t.x(), -t.y(), t.x(), 0;
  return camera.K().inverse().transpose() * cross * T_t_r.rotation().matrix() *
         camera.K().inverse();
}

TEST(PairMatcher, EpipoleInsideTheImage) {
  const auto flight = make_flight();
  const auto matcher = make_matcher();
  const Pose a = flight->true_pose(50);
  const Pose b = a * Pose(Eigen::Matrix3d::Identity(), Eigen::Vector3d(0.4, -0.2, 6.0));  // forward
  const Camera& camera = flight->camera();
  const Eigen::Matrix3d F = true_fundamental(camera, a, b);
  for (const bool known : {false, true}) {
    PairKnowledge knowledge;
    if (known) knowledge.F = F;
    const auto result = match_images(*matcher, flight->render(a, 0)->grey,
                                     flight->render(b, 1)->grey, camera, knowledge);
    ASSERT_TRUE(result.F) << result.refusal;
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(*result.F, Eigen::ComputeFullU);
    const Eigen::Vector3d epipole = svd.matrixU().col(2);
    EXPECT_TRUE(camera.in_image(epipole.hnormalized()));
    EXPECT_GT(result.matches.size(), 600U);
    TruthErrors errors;
    add_matches(errors, *flight, a, b, result);
    EXPECT_LT(errors.quantile(0.5), 0.15);
    EXPECT_LT(errors.share_above(3), 0.005);
  }
}

TEST(PairMatcher, KnownGeometryReplacesTheFullSearch) {
  const auto flight = make_flight();
  const auto matcher = make_matcher();
  const Pose a = flight->true_pose(20), b = flight->true_pose(32);
  PairKnowledge known;
  known.F = true_fundamental(flight->camera(), a, b);
  const auto result = match_images(*matcher, flight->render(20)->grey, flight->render(32)->grey,
                                   flight->camera(), known);
  ASSERT_TRUE(result.F) << result.refusal;
  EXPECT_GT(result.matches.size(), 600U);
  TruthErrors errors;
  add_matches(errors, *flight, a, b, result);
  EXPECT_LT(errors.share_above(3), 0.005);
}

// Far views of a street of identical windows: from nothing, everything is found one period off.
TEST(PairMatcher, KnownGeometryMatchesWhatNothingElseCan) {
  const auto flight = make_flight(FlightPath::facade);
  const auto matcher = make_matcher();
  const Pose a = flight->true_pose(60), b = flight->true_pose(120);
  const GreyImage image_a = flight->render(60)->grey, image_b = flight->render(120)->grey;
  PairKnowledge known;
  known.F = true_fundamental(flight->camera(), a, b);
  const auto right = [&](const PairKnowledge& knowledge) {
    const auto result = match_images(*matcher, image_a, image_b, flight->camera(), knowledge);
    TruthErrors errors;
    add_matches(errors, *flight, a, b, result);
    return static_cast<double>(errors.px.size()) * (1 - errors.share_above(3));
  };
  EXPECT_LT(right({}), 50);
  EXPECT_GT(right(known), 400);
}

TEST(PairMatcher, AWrongKnownGeometryIsNotBelieved) {
  const auto flight = make_flight();
  const auto matcher = make_matcher();
  const Pose a = flight->true_pose(20), b = flight->true_pose(24);
  PairKnowledge known;  // of a camera that moved up instead of on, and turned
  known.F = true_fundamental(flight->camera(), a,
                             a * Pose(so3_exp(Eigen::Vector3d(0.2, -0.1, 0.3)), {0.3, -4, 0.5}));
  const auto result = match_images(*matcher, flight->render(20)->grey, flight->render(24)->grey,
                                   flight->camera(), known);
  TruthErrors errors;
  add_matches(errors, *flight, a, b, result);
  EXPECT_LT(errors.share_above(3), 0.005) << result.matches.size();
}

TEST(PairMatcher, AThirdViewTellsCandidatesApart) {
  const auto flight = make_flight(FlightPath::facade);
  const auto matcher = make_matcher();
  const Camera& camera = flight->camera();
  int more = 0, asked = 0;
  TruthErrors errors;
  for (std::size_t i : {10U, 60U, 110U}) {
    const MatchView reference = matcher->prepare(flight->render(i)->grey, camera);
    const MatchView between = matcher->prepare(flight->render(i + 4)->grey, camera);
    const MatchView target = matcher->prepare(flight->render(i + 8)->grey, camera);
    const PairMatches first = matcher->match(reference, between);
    ASSERT_TRUE(first.F) << first.refusal;
    const std::vector<AuxiliaryMatches> auxiliary{auxiliary_matches(reference, between, first)};
    PairKnowledge known;
    known.auxiliary = auxiliary;
    const PairMatches alone = matcher->match(reference, target);
    const PairMatches helped = matcher->match(reference, target, known);
    expect_complete(reference, helped);
    ASSERT_TRUE(helped.F) << helped.refusal;
    const auto affine = helped.disambiguation.total(DisambiguationModule::affine_transfer);
    const auto transfer = helped.disambiguation.total(DisambiguationModule::epipolar_transfer);
    asked += affine.in + transfer.in;
    more += affine.accepted + transfer.accepted;
    EXPECT_EQ(alone.disambiguation.total(DisambiguationModule::affine_transfer).in, 0);
    EXPECT_GE(helped.matches.size() + 3, alone.matches.size());
    add_matches(errors, *flight, flight->true_pose(i), flight->true_pose(i + 8), helped);
  }
  EXPECT_GT(asked, 0);
  EXPECT_GT(more, 0);
  EXPECT_LT(errors.share_above(3), 0.005);
  EXPECT_LT(errors.share_above(1), 0.04);
}

TEST(PairMatcher, TakesCarriedPointsFirstAndExactly) {
  const auto flight = make_flight();
  const auto matcher = make_matcher();
  const auto a = flight->render(0), b = flight->render(4), c = flight->render(8);
  const MatchView first = matcher->prepare(a->grey, flight->camera());
  const MatchView second_plain = matcher->prepare(b->grey, flight->camera());
  const PairMatches one = matcher->match(first, second_plain);
  ASSERT_TRUE(one.F);
  std::vector<Eigen::Vector2d> carried;
  for (const PairMatch& match : one.matches) carried.push_back(match.x_t);
  const MatchView second = matcher->prepare(b->grey, flight->camera(), carried);
  ASSERT_GE(second.points.size(), carried.size());
  for (std::size_t i = 0; i < carried.size(); ++i) ASSERT_EQ(second.points[i], carried[i]);
  const PairMatches two = matcher->match(second, matcher->prepare(c->grey, flight->camera()));
  ASSERT_TRUE(two.F);
  const auto kept = std::count_if(two.matches.begin(), two.matches.end(),
                                  [&](const auto& match) { return match.point < carried.size(); });
  EXPECT_GT(kept, static_cast<std::ptrdiff_t>(carried.size() / 2));
}

TEST(PairMatcher, TinyImagesAreRefusedWithWords) {
  const auto matcher = make_matcher();
  Camera camera;
  camera.width_px = camera.height_px = 16;
  camera.fx_px = camera.fy_px = 20;
  camera.cx_px = camera.cy_px = 7.5;
  const auto result = match_images(*matcher, noise(16, 16, 1), noise(16, 16, 1), camera);
  EXPECT_FALSE(result.F);
  EXPECT_NE(result.refusal.find("interest points"), std::string::npos) << result.refusal;
}

}  // namespace
}  // namespace corvid
