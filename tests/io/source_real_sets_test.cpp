#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "io/source_test_files.h"

namespace corvid {
namespace {

using test::has_note;

class RealSets : public testing::Test {
 protected:
  static std::string set(const std::string& name) {
    return std::string(CORVID_SOURCE_DIR) + "/../shared/data/" + name;
  }
  /// Opens a set, or returns null where the data is not on this machine.
  static std::unique_ptr<FrameSource> open(const std::string& name, SourceOptions options = {}) {
    if (!std::filesystem::exists(set(name))) return nullptr;
    return test::opened(set(name), options);
  }
};

#define OPEN_OR_SKIP(source, ...)                                                                  \
  const auto source = open(__VA_ARGS__);                                                           \
  if (!source && !HasFailure()) GTEST_SKIP() << "the real image sets (../shared/data) are absent"; \
  ASSERT_TRUE(source)

// Every consecutive pair of poses is near: a wrong convention shows as jumps or huge turns.
void expect_smooth(const Trajectory& truth, double max_step, double max_turn_rad) {
  for (std::size_t i = 1; i < truth.size(); ++i) {
    const Pose step = truth[i - 1].T_world_camera.inverse() * truth[i].T_world_camera;
    ASSERT_LT(step.translation().norm(), max_step) << i;
    ASSERT_LT(so3_log(step.rotation()).norm(), max_turn_rad) << i;
    ASSERT_LT(truth[i - 1].time_ns, truth[i].time_ns);
  }
}

TEST_F(RealSets, Euroc) {
  OPEN_OR_SKIP(source, "euroc_mh05_a");
  const SourceInfo& info = source->info();
  EXPECT_EQ(info.kind, "EuRoC/ASL");
  EXPECT_EQ(info.frames, 300u);
  EXPECT_NEAR(info.rate_hz, 20, 0.01);
  EXPECT_FALSE(info.stills);
  EXPECT_FALSE(info.colour);
  EXPECT_EQ(info.intrinsics, IntrinsicsOrigin::calibration);
  const Camera& camera = *info.camera;
  EXPECT_EQ(camera.model, CameraModel::radtan);
  EXPECT_EQ(camera.width_px, 752);
  EXPECT_EQ(camera.height_px, 480);
  EXPECT_EQ(camera.fx_px, 458.654);
  EXPECT_EQ(camera.cy_px, 248.375);
  EXPECT_EQ(camera.distortion,
            (std::array<double, 5>{-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0}));
  const auto frames = test::all_frames(*source);
  ASSERT_EQ(frames.size(), 300u);
  EXPECT_EQ(frames.front()->time_ns, 1403638538577829376);
  EXPECT_EQ(frames.back()->time_ns, 1403638553527829504);
  EXPECT_EQ(frames.front()->grey.width(), 752);
  EXPECT_EQ(source->counts().delivered, 300u);
  EXPECT_EQ(source->counts().skipped, 0u);

  const Trajectory truth = source->truth();
  EXPECT_EQ(truth.size(), 3391u);
  EXPECT_LE(truth.front().time_ns, frames.front()->time_ns + 1'000'000);
  EXPECT_GE(truth.back().time_ns, frames.back()->time_ns);
  expect_smooth(truth, 0.02, 0.02);
  // The camera's axes, not the body's: in this hall z is up and the camera looks level, so its y
  // axis points down and its optical axis is level. Body axes would be upright.
  const Eigen::Matrix3d R = truth[1500].T_world_camera.R();
  EXPECT_LT(R(2, 1), -0.8);
  EXPECT_LT(std::abs(R(2, 2)), 0.6);
  // The camera sits 7 cm from the body's origin (norm of T_BS's translation).
  const Eigen::Vector3d body(4.603211, -1.656314, 0.568585);
  EXPECT_NEAR((truth.front().T_world_camera.translation() - body).norm(), 0.0689, 1e-3);
  // Opening its mav0 or cam0 gives the same.
  EXPECT_EQ(open("euroc_mh05_a/mav0")->info().frames, 300u);
  EXPECT_EQ(open("euroc_mh05_a/mav0/cam0")->truth().size(), 3391u);
}

TEST_F(RealSets, Kitti) {
  OPEN_OR_SKIP(source, "kitti07");
  const SourceInfo& info = source->info();
  EXPECT_EQ(info.kind, "KITTI odometry");
  EXPECT_EQ(info.frames, 160u);
  EXPECT_NEAR(info.rate_hz, 9.6, 0.1);
  EXPECT_FALSE(info.stills);
  const Camera& camera = *info.camera;
  EXPECT_EQ(camera.model, CameraModel::pinhole);
  EXPECT_EQ(camera.width_px, 1226);
  EXPECT_EQ(camera.height_px, 370);
  EXPECT_EQ(camera.fx_px, 707.0912);
  EXPECT_EQ(camera.cx_px, 601.8873);
  const auto frames = test::all_frames(*source);
  ASSERT_EQ(frames.size(), 160u);
  EXPECT_EQ(frames[0]->time_ns, 0);
  EXPECT_EQ(frames[1]->time_ns, 103'875'200);
  EXPECT_EQ(frames.back()->time_ns, 16'533'760'000);
  EXPECT_EQ(source->counts().skipped, 0u);
  const Trajectory truth = source->truth();
  ASSERT_EQ(truth.size(), 160u);
  EXPECT_EQ(truth.back().time_ns, frames.back()->time_ns);
  EXPECT_LT((truth.front().T_world_camera.matrix() - Eigen::Matrix4d::Identity()).norm(), 1e-8);
  double length = 0;
  for (std::size_t i = 1; i < truth.size(); ++i) {
    length +=
        (truth[i].T_world_camera.translation() - truth[i - 1].T_world_camera.translation()).norm();
  }
  EXPECT_NEAR(length, 90.6, 0.1);
  // A car drives along its optical axis.
  EXPECT_GT((truth[0].T_world_camera.inverse() * truth[20].T_world_camera).translation().z(), 1.0);
  expect_smooth(truth, 1.5, 0.1);
}

TEST_F(RealSets, AerialPhotographs) {
  for (const char* name : {"aerial_caliterra_a", "aerial_caliterra_a/images"}) {
    OPEN_OR_SKIP(source, name);
    const SourceInfo& info = source->info();
    EXPECT_EQ(info.kind, "image folder");
    EXPECT_EQ(info.frames, 45u);
    EXPECT_TRUE(info.stills);
    EXPECT_TRUE(info.colour);
    EXPECT_EQ(info.intrinsics, IntrinsicsOrigin::exif);
    EXPECT_NEAR(info.camera->fx_px, 1459, 1);
    EXPECT_NEAR(info.camera->cx_px, 999.5, 1e-9);
    EXPECT_EQ(info.camera->width_px, 2000);
    EXPECT_TRUE(has_note(info.notes, "SX260"));
    EXPECT_TRUE(has_note(info.notes, "GPS positions in the EXIF of 45 images"));
    EXPECT_TRUE(source->truth().empty());
    const auto first = source->next();
    ASSERT_TRUE(first && *first);
    EXPECT_EQ((*first)->time_ns, 1413724851'000'000'000);  // 2014-10-19 13:20:51
    EXPECT_EQ((*first)->name, "IMG_9354.jpg");
    const auto second = source->next();
    EXPECT_EQ((*second)->time_ns - (*first)->time_ns, 2'000'000'000);
  }
}

TEST_F(RealSets, StrechaFountain) {
  OPEN_OR_SKIP(source, "strecha_fountain_p11");
  const SourceInfo& info = source->info();
  EXPECT_EQ(info.kind, "Strecha multi-view");
  EXPECT_EQ(info.frames, 11u);
  EXPECT_TRUE(info.stills);
  EXPECT_EQ(info.camera->fx_px, 2759.48);
  EXPECT_EQ(info.camera->fy_px, 2764.16);
  EXPECT_EQ(info.camera->width_px, 3072);
  EXPECT_EQ(info.camera->height_px, 2048);
  const Trajectory truth = source->truth();
  ASSERT_EQ(truth.size(), 11u);
  EXPECT_NEAR(truth[0].T_world_camera.translation().x(), -7.28137, 1e-9);
  EXPECT_NEAR(truth[0].T_world_camera.R()(0, 2), -0.887537, 1e-5);
  // All cameras look at the fountain: the optical axes of the first and the last cross in front.
  const Pose &a = truth.front().T_world_camera, &b = truth.back().T_world_camera;
  EXPECT_GT((a.inverse() * (b * Eigen::Vector3d(0, 0, 8))).z(), 0);
  expect_smooth(truth, 3, 0.5);
}

TEST_F(RealSets, MiddleburyTempleRing) {
  OPEN_OR_SKIP(source, "middlebury_temple_ring");
  const SourceInfo& info = source->info();
  EXPECT_EQ(info.kind, "Middlebury multi-view");
  EXPECT_EQ(info.frames, 47u);
  EXPECT_TRUE(info.stills);
  EXPECT_EQ(info.camera->fx_px, 1520.4);
  EXPECT_EQ(info.camera->fy_px, 1525.9);
  EXPECT_EQ(info.camera->cx_px, 302.32);
  const Trajectory truth = source->truth();
  ASSERT_EQ(truth.size(), 47u);
  // Every camera sees the middle of the temple's bounding box near the middle of its image.
  const Eigen::Vector3d centre(0.0277575, 0.041814, -0.0546685);
  for (const StampedPose& pose : truth) {
    const auto pixel = info.camera->project(pose.T_world_camera.inverse() * centre);
    ASSERT_TRUE(pixel);
    EXPECT_NEAR(pixel->x(), 320, 100);
    EXPECT_NEAR(pixel->y(), 240, 100);
  }
}

TEST_F(RealSets, SevenScenes) {
  OPEN_OR_SKIP(source, "rk7s_a");
  const SourceInfo& info = source->info();
  EXPECT_EQ(info.kind, "7-Scenes");
  EXPECT_EQ(info.frames, 150u);
  EXPECT_NEAR(info.rate_hz, 30, 0.01);
  EXPECT_FALSE(info.stills);
  EXPECT_TRUE(info.has_depth);
  EXPECT_EQ(info.camera->fx_px, 525);
  EXPECT_EQ(info.intrinsics, IntrinsicsOrigin::nominal);
  EXPECT_TRUE(has_note(info.notes, "depth camera's"));
  const Trajectory truth = source->truth();
  ASSERT_EQ(truth.size(), 150u);
  EXPECT_NEAR(truth[0].T_world_camera.translation().z(), 0.29656917, 1e-8);
  expect_smooth(truth, 0.2, 0.2);
  const auto frame = source->next();
  ASSERT_TRUE(frame && *frame);
  EXPECT_EQ((*frame)->colour.width(), 640);
}

TEST_F(RealSets, CheckerBoard) {
  OPEN_OR_SKIP(source, "vamr1_checker");
  const SourceInfo& info = source->info();
  EXPECT_EQ(info.kind, "image folder");
  EXPECT_EQ(info.frames, 99u);
  EXPECT_NEAR(info.rate_hz, 30, 0.01);
  EXPECT_FALSE(info.stills);
  EXPECT_EQ(info.intrinsics, IntrinsicsOrigin::calibration);
  EXPECT_EQ(info.camera->model, CameraModel::radtan);
  EXPECT_EQ(info.camera->fx_px, 420.506712);
  EXPECT_EQ(info.camera->distortion[0], -0.296609);
  EXPECT_EQ(info.camera->distortion[1], 0.080818);
  EXPECT_EQ(info.camera->width_px, 752);
  const Trajectory truth = source->truth();
  ASSERT_EQ(truth.size(), 99u);
  expect_smooth(truth, 0.05, 0.1);
  // The board's corner (the world's origin) is in front of every camera and in its image.
  for (const StampedPose& pose : truth) {
    const auto pixel =
        info.camera->project(pose.T_world_camera.inverse() * Eigen::Vector3d::Zero());
    ASSERT_TRUE(pixel);
    EXPECT_TRUE(info.camera->in_image(*pixel));
  }
}

TEST_F(RealSets, Facades) {
  OPEN_OR_SKIP(source, "facades_paris_a");
  const SourceInfo& info = source->info();
  EXPECT_EQ(info.kind, "image folder");
  EXPECT_EQ(info.frames, 12u);
  EXPECT_FALSE(info.stills);
  EXPECT_EQ(info.intrinsics, IntrinsicsOrigin::guess);
  const auto frame = source->next();
  ASSERT_TRUE(frame && *frame);
  EXPECT_EQ((*frame)->name, "facade_1.png");
  // They differ in size: the first one's size counts, the others are skipped with a message.
  std::size_t delivered = 1 + test::all_frames(*source).size();
  EXPECT_EQ(delivered + source->counts().skipped, 12u);
  EXPECT_TRUE(source->counts().skipped == 0 ||
              has_note(source->counts().messages, "but the first has"));
}

TEST_F(RealSets, OptionsSelect) {
  SourceOptions options;
  options.first = 10;
  options.step = 3;
  options.count = 5;
  options.colour = false;
  OPEN_OR_SKIP(source, "kitti07", options);
  const auto frames = test::all_frames(*source);
  ASSERT_EQ(frames.size(), 5u);
  EXPECT_EQ(frames[1]->name, "000013.png");
  EXPECT_EQ(frames[1]->id, FrameId(1));
  EXPECT_EQ(source->truth().size(), 5u);
}

}  // namespace
}  // namespace corvid
