#include "io/camera/libcamera_format.h"

#include <gtest/gtest.h>
#include <libcamera/formats.h>

#include <string>
#include <utility>
#include <vector>

#include "io/camera/raw_image.h"

namespace corvid {
namespace {

TEST(LibcameraFormat, NamesAreLibcamerasAndBytesAreV4l2s) {
  // The bytes in memory: DRM's words are little-endian, V4L2's names give the order in memory.
  const std::vector<std::pair<libcamera::PixelFormat, std::string>> expected = {
      {libcamera::formats::R8, "GREY"},
      {libcamera::formats::R10, "Y10 "},
      {libcamera::formats::R12, "Y12 "},
      {libcamera::formats::R10_CSI2P, "Y10P"},
      {libcamera::formats::RGB888, "BGR3"},
      {libcamera::formats::BGR888, "RGB3"},
      {libcamera::formats::XRGB8888, "XR24"},
      {libcamera::formats::XBGR8888, "XB24"},
      {libcamera::formats::YUYV, "YUYV"},
      {libcamera::formats::VYUY, "VYUY"},
      {libcamera::formats::NV12, "NV12"},
      {libcamera::formats::NV21, "NV21"},
      {libcamera::formats::YUV420, "YU12"},
      {libcamera::formats::YVU420, "YV12"},
      {libcamera::formats::MJPEG, "MJPG"},
      {libcamera::formats::SBGGR8, "BA81"},
      {libcamera::formats::SRGGB8, "RGGB"},
      {libcamera::formats::SGRBG10, "BA10"},
      {libcamera::formats::SRGGB10_CSI2P, "pRAA"},
      {libcamera::formats::SGBRG12_CSI2P, "pGCC"},
      {libcamera::formats::SRGGB16, "RG16"},
      {libcamera::formats::SBGGR16, "BYR2"},
  };
  for (const auto& [format, fourcc] : expected) {
    EXPECT_EQ(fourcc_name(v4l2_fourcc_of(format.toString())), fourcc) << format.toString();
  }
  EXPECT_EQ(v4l2_fourcc_of(""), 0U);
  EXPECT_EQ(v4l2_fourcc_of("SRGGB10_IPU3"), 0U) << "V4L2 has it, but no conversion";
  EXPECT_EQ(v4l2_fourcc_of("<ABCD>"), 0U);
}

std::string chosen(const std::vector<OfferedFormat>& offered, const CameraRequest& request) {
  const auto index = choose_format(offered, request);
  return index ? offered[*index].name : index.error().to_string();
}

TEST(LibcameraFormat, ChoosesTheBestForGreyThatHasTheSize) {
  CameraRequest request;
  request.device = "cam";
  EXPECT_EQ(chosen({{"MJPEG", true}, {"YUYV", true}, {"R8", true}}, request), "R8");
  EXPECT_EQ(chosen({{"MJPEG", true}, {"YUYV", false}, {"R8", false}}, request), "MJPEG");
  EXPECT_EQ(chosen({{"MJPEG", false}, {"YUYV", false}}, request), "YUYV") << "none has it";
  EXPECT_EQ(chosen({{"SRGGB10_IPU3", true}, {"BGR888", false}}, request), "BGR888")
      << "what is not understood comes last";
  request.colour = true;
  EXPECT_EQ(chosen({{"MJPEG", true}, {"YUYV", true}, {"R8", true}}, request), "YUYV");
  EXPECT_EQ(chosen({{"R10", true}, {"R8", true}}, request), "R8") << "no colour to be had";
}

TEST(LibcameraFormat, TakesWhatIsAskedForOrSaysWhatThereIs) {
  CameraRequest request;
  request.device = "cam";
  request.format = "MJPEG";
  EXPECT_EQ(chosen({{"R8", true}, {"MJPEG", false}}, request), "MJPEG");
  request.format = "YUVY";
  EXPECT_EQ(chosen({{"R8", true}, {"YUYV", true}}, request),
            "cam: the camera has no format YUVY (did you mean YUYV? the camera has R8, YUYV)");
  request.format = "SRGGB10_IPU3";
  EXPECT_EQ(chosen({{"SRGGB10_IPU3", true}}, request),
            "cam: pictures of format SRGGB10_IPU3 are not understood (the camera has "
            "SRGGB10_IPU3)");
  request.format.clear();
  const auto none = choose_format({}, request);
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::unsupported);
}

}  // namespace
}  // namespace corvid
