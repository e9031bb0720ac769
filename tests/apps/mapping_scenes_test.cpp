#include "apps/mapping_scenes.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>

#include "io/source.h"
#include "program_fixture.h"

namespace corvid {
namespace {

class MappingScenesTest : public ProgramTest {
 protected:
  /// Six frames of 64x48 px in seq-01 of a scene, each i * 0.1 m to the right of the first, and
  /// depth of 2 m + i mm; none of frame 2.
  std::string seven_scenes() const {
    const std::string sequence = path("kitchen/seq-01/");
    std::filesystem::create_directories(sequence);
    write("kitchen/K.txt", "60 0 31.5\n0 60 23.5\n0 0 1\n");
    for (int i = 0; i < 6; ++i) {
      const std::string stem = fmt::format("kitchen/seq-01/frame-{:06d}", i);
      cv::imwrite(path(stem + ".color.png"), cv::Mat(48, 64, CV_8UC1, cv::Scalar(100 + i)));
      write(stem + ".pose.txt", fmt::format("1 0 0 {}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", 0.1 * i));
      if (i != 2)
        cv::imwrite(path(stem + ".depth.png"), cv::Mat(480, 640, CV_16UC1, cv::Scalar(2000 + i)));
    }
    return path("kitchen");
  }
};

TEST_F(MappingScenesTest, DepthOfSevenScenesLiesBesideTheFrames) {
  const auto source = open_source(seven_scenes());
  ASSERT_TRUE(source) << source.error().to_string();
  const auto scene = read_mapping_scene(**source, 1, 100, {});
  ASSERT_TRUE(scene) << scene.error().to_string();
  ASSERT_EQ(scene->views.size(), 6U);
  EXPECT_TRUE(has_true_depth(*scene));
  for (int i = 0; i < 6; ++i) {
    const TrueView& view = scene->views[static_cast<std::size_t>(i)];
    EXPECT_NEAR(view.T_world_camera.translation().x(), 0.1 * i, 1e-9);
    ASSERT_EQ(view.depth.width(), 64);
    ASSERT_EQ(view.depth.height(), 48);
    EXPECT_NEAR(view.depth(32, 24), i == 2 ? 0 : 2 + 0.001 * i, 1e-6) << i;
  }
}

TEST_F(MappingScenesTest, DepthThatIsOnlyNotedIsNoTruth) {
  const std::string folder = path("tum");
  std::filesystem::create_directories(folder + "/rgb");
  std::string list, truth;
  for (int i = 0; i < 6; ++i) {
    cv::imwrite(fmt::format("{}/rgb/{}.png", folder, i), cv::Mat(48, 64, CV_8UC1, cv::Scalar(9)));
    list += fmt::format("{}.0 rgb/{}.png\n", i + 1, i);
    truth += fmt::format("{}.0 {} 0 0 0 0 0 1\n", i + 1, i);
  }
  write("tum/rgb.txt", list);
  write("tum/depth.txt", "1.0 depth/1.png\n");
  write("tum/groundtruth.txt", truth);
  write("tum/K.txt", "60 0 31.5\n0 60 23.5\n0 0 1\n");
  const auto source = open_source(folder);
  ASSERT_TRUE(source) << source.error().to_string();
  EXPECT_TRUE((*source)->info().has_depth);
  const auto scene = read_mapping_scene(**source, 1, 100, {});
  ASSERT_TRUE(scene) << scene.error().to_string();
  EXPECT_FALSE(has_true_depth(*scene));
}

}  // namespace
}  // namespace corvid
