#include "io/camera/libcamera_camera.h"

#include <gtest/gtest.h>

#include <string>

#include "scenes/folder_entries.h"

namespace corvid {
namespace {

// The machine may have cameras; tests/vm has those that are sure to be there.
TEST(LibcameraCamera, UnknownCameraIsNotFoundAndNothingIsPrinted) {
  SteadyClock clock;
  CameraRequest request;
  request.device = "no such camera";
  testing::internal::CaptureStderr();
  testing::internal::CaptureStdout();
  for (int i = 0; i < 3; ++i) {
    const bool any = !list_libcamera_cameras().empty();
    const auto stream = open_libcamera(request, clock);
    ASSERT_FALSE(stream);
    EXPECT_EQ(stream.error().code, ErrorCode::not_found);
    EXPECT_EQ(stream.error().where, "no such camera");
    EXPECT_EQ(stream.error().what, any ? "no such camera" : "libcamera finds no camera at all");
    EXPECT_NE(stream.error().hint.find(any ? "there are: " : "udev"), std::string::npos)
        << stream.error().hint;
  }
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
}

TEST(LibcameraCamera, NothingIsLeftWhenNobodyHoldsACamera) {
  (void)list_libcamera_cameras();  // what the first start leaves for good
  const std::size_t files = entries_of("/proc/self/fd"), threads = entries_of("/proc/self/task");
  for (int i = 0; i < 10; ++i) (void)list_libcamera_cameras();
  EXPECT_EQ(entries_of("/proc/self/fd"), files);
  EXPECT_EQ(entries_of("/proc/self/task"), threads);
}

}  // namespace
}  // namespace corvid
