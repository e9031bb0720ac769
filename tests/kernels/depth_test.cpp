#include "kernels/depth.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "oracle/depth.h"
#include "scenes/plane_views.h"

namespace corvid {
namespace {

using testing::pinhole;
using testing::PlaneScene;

std::shared_ptr<Device> device() {
  static const auto opened = Device::open("auto");
  if (!opened) throw std::runtime_error(opened.error().to_string());
  return *opened;
}

Pose at(double x, double y, double z, const Eigen::Vector3d& turn = Eigen::Vector3d::Zero()) {
  return {so3_exp(turn), {x, y, z}};
}

/// A reference view and its neighbours, on the host and on the device.
struct Views {
  Camera camera;
  std::vector<Pose> poses;  ///< T_world_camera, the reference first
  std::vector<GreyImage> images;

  Views(const PlaneScene& scene, const Camera& c, std::vector<Pose> T)
      : camera(c), poses(std::move(T)) {
    for (const Pose& pose : poses) images.push_back(scene.render(camera, pose));
  }
  [[nodiscard]] Pose T_neighbour_reference(std::size_t i) const {
    return poses[i].inverse() * poses[0];
  }
  [[nodiscard]] SweepResult estimate(DepthSweeper& sweeper, double near, double far, int samples,
                                     int refinements, int scale = 1,
                                     bool coarse_to_fine = false) const {
    std::vector<SweepImage> prepared;
    for (const GreyImage& image : images) {
      prepared.push_back(sweeper.prepare(upload(*device(), image), scale));
    }
    const Camera small = DepthSweeper::scaled(camera, scale);
    std::vector<SweepNeighbour> neighbours;
    for (std::size_t i = 1; i < prepared.size(); ++i) {
      neighbours.push_back({&prepared[i], small, T_neighbour_reference(i)});
    }
    return sweeper.estimate(
        {&prepared[0], small, neighbours, near, far, samples, coarse_to_fine, refinements});
  }
};

DepthSweeper make_sweeper(const DepthSweepOptions& options = {}, const std::string& extra = {}) {
  auto sweeper = DepthSweeper::create(device(), options, extra);
  if (!sweeper) throw std::runtime_error(sweeper.error().to_string());
  return std::move(*sweeper);
}

PlaneScene slanted_wall() {
  PlaneScene scene;
  scene.planes = {{Eigen::Vector3d(0.35, -0.2, 1).normalized(), 3.4}};
  scene.finest = 0.06;
  return scene;
}

/// Odd sizes, all neighbours turned and displaced differently.
Views small_views() {
  return {slanted_wall(),
          pinhole(47, 35, 46),
          {at(0, 0, 0), at(0.25, 0.02, 0, {0.01, -0.03, 0.02}), at(-0.2, 0.1, 0.05, {0, 0.04, 0}),
           at(0.05, -0.3, 0.1, {-0.05, 0, 0.01})}};
}

struct Comparison {
  int rays = 0, answers_differ = 0;
  double worst_score = 0, worst_step = 0;
};

Comparison compare_with_oracle(const std::string& extra_options, int scale, int vector_px) {
  const Views views = small_views();
  oracle::DepthSettings s;
  s.near = 2, s.far = 6, s.samples = 30;
  DepthSweepOptions options;
  options.vector_px = vector_px;
  DepthSweeper sweeper = make_sweeper(options, extra_options);
  const SweepResult result = views.estimate(sweeper, s.near, s.far, s.samples, 0, scale);
  std::vector<Image<double>> images;
  for (const GreyImage& image : views.images) {
    images.push_back(oracle::mean_of_blocks(image, scale));
  }
  const Camera camera = DepthSweeper::scaled(views.camera, scale);
  std::vector<oracle::DepthView> neighbours;
  for (std::size_t i = 1; i < images.size(); ++i) {
    neighbours.push_back({&images[i], camera, views.T_neighbour_reference(i)});
  }
  Comparison out;
  const double step = (1 / s.near - 1 / s.far) / (s.samples - 1);
  for (int y = 0; y < result.depth.height(); ++y) {
    for (int x = 0; x < result.depth.width(); ++x) {
      const auto scores = oracle::ray_scores(images[0], camera, neighbours, x, y, s);
      const oracle::RayAnswer truth = oracle::best_peak(scores, s);
      ++out.rays;
      const bool answered = result.depth(x, y) > 0;
      if (answered != (truth.inverse > 0)) {
        ++out.answers_differ;
        continue;
      }
      if (!answered) continue;
      const double off = std::abs(1.0 / result.depth(x, y) - truth.inverse) / step;
      // Two peaks of nearly one height: either is right.
      if (off > 0.5 && truth.margin < 1e-3) continue;
      out.worst_step = std::max(out.worst_step, off);
      out.worst_score = std::max(out.worst_score, std::abs(result.confidence(x, y) - truth.score));
    }
  }
  return out;
}

TEST(Depth, SweepEqualsTheOracle) {
  for (const int vector_px : {1, 16}) {
    for (const int scale : {1, 2}) {
      const Comparison c = compare_with_oracle("", scale, vector_px);
      EXPECT_LE(c.answers_differ, c.rays / 200) << "scale " << scale << " vector " << vector_px;
      EXPECT_LT(c.worst_score, 1e-3) << "scale " << scale << " vector " << vector_px;
      EXPECT_LT(c.worst_step, 0.1) << "scale " << scale << " vector " << vector_px;
    }
  }
}

TEST(Depth, APlantedFaultIsCaught) {
  for (const int vector_px : {1, 16}) {
    EXPECT_GT(compare_with_oracle("-DCORVID_PLANT_FAULT", 1, vector_px).worst_score, 1e-3);
  }
}

struct Accuracy {
  double answered = 0, within_1 = 0, within_2 = 0;
};

/// Of the rays that have a true depth inside the interval and whose template is whole.
Accuracy accuracy(const FloatImage& depth, const FloatImage& truth, int border) {
  int rays = 0, answers = 0, good_1 = 0, good_2 = 0;
  for (int y = border; y < depth.height() - border; ++y) {
    for (int x = border; x < depth.width() - border; ++x) {
      if (!(truth(x, y) > 0)) continue;
      ++rays;
      if (!(depth(x, y) > 0)) continue;
      ++answers;
      const double e = std::abs(depth(x, y) / truth(x, y) - 1);
      good_1 += e < 0.01;
      good_2 += e < 0.02;
    }
  }
  const auto share = [](int a, int b) { return b > 0 ? static_cast<double>(a) / b : 0.0; };
  return {share(answers, rays), share(good_1, answers), share(good_2, answers)};
}

Views wall_from_beside(int width_px, int height_px) {
  return {slanted_wall(),
          pinhole(width_px, height_px, 150),
          {at(0, 0, 0), at(-0.4, 0, 0), at(-0.2, 0.05, 0), at(0.2, 0, 0.05), at(0.4, 0.05, 0)}};
}

TEST(Depth, SidewaysViewsOfASlantedWall) {
  const Views views = wall_from_beside(188, 120);
  DepthSweeper sweeper = make_sweeper();
  const FloatImage truth = slanted_wall().depth(views.camera, views.poses[0]);
  const Accuracy sweep = accuracy(views.estimate(sweeper, 1.5, 9, 96, 0).depth, truth, 5);
  const Accuracy refined = accuracy(views.estimate(sweeper, 1.5, 9, 96, 3).depth, truth, 5);
  EXPECT_GT(refined.answered, 0.95);
  EXPECT_GT(refined.within_1, 0.95);
  EXPECT_GT(refined.within_1, sweep.within_1);
}

TEST(Depth, GroundUnderAForwardFlightWithTheEpipoleInTheImage) {
  // A camera low over the ground, looking ahead and down, flying ahead.
  PlaneScene scene;
  scene.planes = {{Eigen::Vector3d(0, 1, 0), 1.5}, {Eigen::Vector3d(0, 0, 1), 14}};
  scene.finest = 0.08;
  const Eigen::Vector3d down(-0.25, 0, 0);
  const Views views(scene, pinhole(188, 120, 140),
                    {at(0, 0, 0, down), at(0, 0, -1.2, down), at(0.02, 0, -0.6, down),
                     at(0, 0.02, 0.6, down), at(0, 0, 1.2, down)});
  DepthSweeper sweeper = make_sweeper();
  const FloatImage truth = scene.depth(views.camera, views.poses[0]);
  const Accuracy sweep = accuracy(views.estimate(sweeper, 2, 30, 96, 0).depth, truth, 5);
  const Accuracy refined = accuracy(views.estimate(sweeper, 2, 30, 96, 3).depth, truth, 5);
  EXPECT_GT(refined.answered, 0.6);
  EXPECT_GT(refined.within_2, 0.85);
  EXPECT_GT(refined.within_2, sweep.within_2) << "slanted planes must mend the sweep's bias";
}

TEST(Depth, FromCoarseToFineFindsWhatTheWholeSweepFinds) {
  const Views views = wall_from_beside(189, 121);
  DepthSweeper sweeper = make_sweeper();
  const FloatImage truth = slanted_wall().depth(views.camera, views.poses[0]);
  const Accuracy fine = accuracy(views.estimate(sweeper, 1.5, 9, 96, 3).depth, truth, 6);
  const Accuracy coarse = accuracy(views.estimate(sweeper, 1.5, 9, 96, 3, 1, true).depth, truth, 6);
  EXPECT_GT(coarse.answered, 0.95 * fine.answered);
  EXPECT_GT(coarse.within_1, 0.95);
}

TEST(Depth, RowsThatOnlyTheFullResolutionSeesAreNotAmbiguous) {
  // At half the resolution the templates of these rows are not whole: nothing is known of rivals.
  const Views views(slanted_wall(), pinhole(189, 121, 150),
                    {at(0, 0, 0), at(-0.4, 0, 0), at(-0.2, 0.05, 0), at(0.2, 0, 0.05)});
  DepthSweeper sweeper = make_sweeper();
  const SweepResult result = views.estimate(sweeper, 1.5, 9, 96, 3, 1, true);
  for (const int first : {5, 121 - 10}) {
    int answers = 0;
    for (int y = first; y < first + 5; ++y) {
      for (int x = 5; x < 184; ++x) {
        if (!(result.depth(x, y) > 0)) continue;
        ++answers;
        EXPECT_GT(result.lead(x, y), 0.1) << x << " " << y;
      }
    }
    EXPECT_GT(answers, 450);
  }
}

TEST(Depth, ABallKeepsItsOutlineBeforeAWall) {
  PlaneScene scene;
  scene.planes = {{Eigen::Vector3d(0, 0, 1), 5}};
  scene.spheres = {{Eigen::Vector3d(0, 0, 3), 0.6}};
  scene.finest = 0.06;
  const Views views(scene, pinhole(240, 180, 190),
                    {at(0, 0, 0), at(-0.4, 0, 0), at(0, -0.3, 0), at(0, 0.3, 0), at(0.4, 0, 0)});
  DepthSweeper sweeper = make_sweeper();
  const FloatImage truth = scene.depth(views.camera, views.poses[0]);
  const FloatImage depth = views.estimate(sweeper, 1.5, 9, 96, 3, 1, true).depth;
  int wall_by_ball = 0, given_to_ball = 0;  // pixels of the wall within 4 px of the ball
  for (int y = 10; y < 170; ++y) {
    for (int x = 10; x < 230; ++x) {
      if (truth(x, y) < 4.9F) continue;
      bool by_ball = false;
      for (int i = 0; i < 81; ++i) by_ball |= truth(x + i % 9 - 4, y + i / 9 - 4) < 4.5F;
      if (!by_ball) continue;
      ++wall_by_ball;
      given_to_ball += depth(x, y) > 0 && depth(x, y) < 4.5F;
    }
  }
  ASSERT_GT(wall_by_ball, 200);
  EXPECT_LT(given_to_ball, wall_by_ball / 10);
  EXPECT_GT(accuracy(depth, truth, 6).answered, 0.75);
}

TEST(Depth, NoAnswerWhereThereIsNothingToSay) {
  DepthSweeper sweeper = make_sweeper();
  const auto answers = [&](const Views& views) {
    const SweepResult r = views.estimate(sweeper, 1.5, 9, 64, 3);
    int n = 0;
    for (std::size_t i = 0; i < r.depth.size(); ++i) {
      EXPECT_TRUE(std::isfinite(r.depth.data()[i]) && std::isfinite(r.confidence.data()[i]));
      n += r.depth.data()[i] > 0;
    }
    return n;
  };
  const Camera camera = pinhole(80, 60, 70);
  const PlaneScene wall = slanted_wall();
  PlaneScene blank = wall;
  blank.contrast = 0;
  EXPECT_GT(answers({wall, camera, {at(0, 0, 0), at(0.2, 0, 0), at(-0.2, 0, 0)}}), 2000);
  EXPECT_EQ(answers({blank, camera, {at(0, 0, 0), at(0.2, 0, 0), at(-0.2, 0, 0)}}), 0);
  const Eigen::Vector3d away(0, 3.1, 0);
  EXPECT_EQ(answers({wall, camera, {at(0, 0, 0), at(0.2, 0, 0, away), at(-0.2, 0, 0, away)}}), 0);
  EXPECT_EQ(answers({wall, camera, {at(0, 0, 0), at(0, 0, 0), at(0, 0, 0)}}), 0);
  EXPECT_EQ(answers({wall, camera, {at(0, 0, 0), at(0.2, 0, 0)}}), 0) << "one neighbour only";
  EXPECT_EQ(answers({wall, camera, {at(0, 0, 0)}}), 0) << "no neighbour";
  // Poses a thousand times too far apart: nothing fits.
  Views wrong(wall, camera, {at(0, 0, 0), at(0.2, 0, 0), at(-0.2, 0, 0)});
  wrong.poses[1] = at(200, 0, 0);
  wrong.poses[2] = at(-200, 0, 0);
  EXPECT_EQ(answers(wrong), 0);
}

TEST(Depth, ResultsRepeatBitForBit) {
  const Views views = small_views();
  DepthSweeper a = make_sweeper(), b = make_sweeper();
  const SweepResult first = views.estimate(a, 2, 6, 48, 3);
  (void)views.estimate(a, 1, 9, 30, 1);
  const SweepResult again = views.estimate(a, 2, 6, 48, 3), other = views.estimate(b, 2, 6, 48, 3);
  EXPECT_EQ(first.depth, again.depth);
  EXPECT_EQ(first.depth, other.depth);
  EXPECT_EQ(first.confidence, other.confidence);
}

TEST(Depth, RefinementIsTheSameWhateverTheVectorLength) {
  const Views views = small_views();
  DepthSweepOptions scalar, wide;
  scalar.vector_px = 1;
  wide.vector_px = 16;
  DepthSweeper a = make_sweeper(scalar), b = make_sweeper(wide);
  const SweepResult x = views.estimate(a, 2, 6, 48, 3), y = views.estimate(b, 2, 6, 48, 3);
  int answers = 0, differing = 0;
  for (std::size_t i = 0; i < x.depth.size(); ++i) {
    answers += x.depth.data()[i] > 0;
    differing += std::abs(x.depth.data()[i] - y.depth.data()[i]) > 1e-3F * x.depth.data()[i];
  }
  EXPECT_GT(answers, 500);
  EXPECT_LE(differing, answers / 20);  // a choice between two nearly equal sides may flip
}

TEST(Depth, OptionsOutOfRangeAreRefused) {
  for (const int side : {0, 2, 10, 33}) {
    DepthSweepOptions options;
    options.template_px = side;
    EXPECT_FALSE(DepthSweeper::create(device(), options).has_value()) << side;
  }
  for (const int side : {3, 9}) {
    DepthSweepOptions options;
    options.template_px = side;
    EXPECT_TRUE(DepthSweeper::create(device(), options).has_value()) << side;
  }
}

TEST(Depth, WhatCannotBeCountedIsRefusedBeforeItIsTried) {
  // 24 megapixels: 4 neighbours are possible, 16 are not.
  DepthSweeper sweeper = make_sweeper();
  EXPECT_LT(sweeper.scores_at_once(6000, 4000, 4, 128), DepthSweeper::kMostScores);
  EXPECT_GT(sweeper.scores_at_once(6000, 4000, 16, 128), DepthSweeper::kMostScores);
  EXPECT_GT(sweeper.scores_at_once(6000, 4000, 4, 128, false), DepthSweeper::kMostScores);
  EXPECT_EQ(sweeper.scores_at_once(32, 20, 2, 64), 32 * 20 * 2 * 64) << "too small to be halved";
  SweepImage image;
  image.full.width_px = 6000, image.full.height_px = 4000;
  image.half.width_px = 3000, image.half.height_px = 2000;
  const Camera camera = pinhole(6000, 4000, 5000);
  const std::vector<SweepNeighbour> neighbours(16, {&image, camera, at(0.1, 0, 0)});
  EXPECT_THROW((void)sweeper.estimate({&image, camera, neighbours, 1, 9, 128}), std::logic_error);
}

TEST(Depth, ScaledCameraSeesTheSameDirections) {
  const Camera full = pinhole(100, 80, 90), half = DepthSweeper::scaled(full, 2);
  EXPECT_EQ(half.width_px, 50);
  // The middle between the pixels 10 and 11 of the full image is pixel 5 of the half one.
  EXPECT_NEAR((full.unproject({10.5, 20.5}).value() - half.unproject({5, 10}).value()).norm(), 0,
              1e-12);
}

}  // namespace
}  // namespace corvid
