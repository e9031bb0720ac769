#include "frontend/predict.h"

#include <gtest/gtest.h>

namespace corvid {
namespace {

const Camera kCamera{CameraModel::radtan,         640, 480, 450, 452, 322, 238,
                     {-0.2, 0.05, 1e-4, -2e-4, 0}};

TEST(Predict, ConstantVelocityIsExactForAScrewMotion) {
  const Vector6d velocity = (Vector6d() << 0.3, -0.1, 0.5, 0.02, 0.04, -0.03).finished();
  MotionState motion;
  const Pose start(so3_exp({0.3, -0.2, 0.1}), {1, 2, 3});
  motion.recent = {{1'000'000'000, start}, {1'050'000'000, start * Pose::exp(velocity)}};
  const auto pose = predict_pose(motion, 1'150'000'000);  // two steps ahead
  ASSERT_TRUE(pose);
  const Pose expected = start * Pose::exp(3 * velocity);
  EXPECT_LT((expected.inverse() * *pose).log().norm(), 1e-9);
}

TEST(Predict, OldOrMissingPosesPredictNothing) {
  MotionState motion;
  EXPECT_FALSE(predict_pose(motion, 5));
  motion.recent = {{0, Pose()}};
  EXPECT_TRUE(predict_pose(motion, 100'000'000));
  EXPECT_FALSE(predict_pose(motion, 3'000'000'000));
  EXPECT_FALSE(predict_pose(motion, -1));
}

TEST(Predict, WarpTakesOffsetsOnAFacingPlaneBackToTheAnchor) {
  const Pose T_world_anchor(so3_exp({0.05, -0.1, 0.02}), {0.2, -0.1, 0});
  const Pose T_world_camera(so3_exp({0.0, 0.15, 0.4}), {0.9, 0.1, 1.5});
  const Eigen::Vector3d p_world(0.6, 0.3, 6);
  const auto warp = predict_warp(kCamera, T_world_anchor, T_world_camera, p_world);
  ASSERT_TRUE(warp);
  // A point of the plane that faces the anchor, seen by both cameras.
  const Eigen::Vector3d p_anchor = T_world_anchor.inverse() * p_world;
  const Eigen::Vector3d normal = p_anchor.normalized();
  for (const Eigen::Vector3d& direction :
       {normal.unitOrthogonal(), normal.cross(normal.unitOrthogonal())}) {
    const Eigen::Vector3d q_world = T_world_anchor * (p_anchor + 0.05 * direction);
    const Eigen::Vector2d offset_camera = *kCamera.project(T_world_camera.inverse() * q_world) -
                                          *kCamera.project(T_world_camera.inverse() * p_world);
    const Eigen::Vector2d offset_anchor = *kCamera.project(T_world_anchor.inverse() * q_world) -
                                          *kCamera.project(T_world_anchor.inverse() * p_world);
    EXPECT_LT((*warp * offset_camera - offset_anchor).norm(), 0.05 * offset_anchor.norm());
  }
}

TEST(Predict, NoWarpBehindTheCameraOrOverLargeScaleChange) {
  const Eigen::Vector3d p_world(0, 0, 10);
  EXPECT_FALSE(
      predict_warp(kCamera, Pose(), Pose(Eigen::Quaterniond::Identity(), {0, 0, 11}), p_world));
  EXPECT_FALSE(
      predict_warp(kCamera, Pose(), Pose(Eigen::Quaterniond::Identity(), {0, 0, 8}), p_world));
  EXPECT_TRUE(
      predict_warp(kCamera, Pose(), Pose(Eigen::Quaterniond::Identity(), {0, 0, 4}), p_world));
}

TEST(Predict, LookupsFindWhatIsThereAndNothingElse) {
  MotionState motion;
  motion.landmarks = {{TrackId(3), {1, 2, 3}}, {TrackId(7), {4, 5, 6}}};
  motion.keyframes = {{FrameId(2), Pose()}};
  ASSERT_NE(find_landmark(motion, TrackId(7)), nullptr);
  EXPECT_EQ(find_landmark(motion, TrackId(7))->x(), 4);
  EXPECT_EQ(find_landmark(motion, TrackId(5)), nullptr);
  EXPECT_NE(find_keyframe(motion, FrameId(2)), nullptr);
  EXPECT_EQ(find_keyframe(motion, FrameId(1)), nullptr);
}

}  // namespace
}  // namespace corvid
