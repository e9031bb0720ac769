#include "mapping/view_images.h"

#include <gtest/gtest.h>

#include "scenes/plane_views.h"

namespace corvid {
namespace {

int width_of_maps(int scale, int width_px, int height_px) {
  const auto device = Device::open("auto").value();
  const ViewImages images(device, Warper::create(device).value(), scale, 1 << 20);
  return images.camera_of(testing::pinhole(width_px, height_px, 500)).width_px;
}

TEST(ViewImages, MapsStayWithin640x480RaysUnlessAScaleIsGiven) {
  EXPECT_EQ(width_of_maps(0, 640, 480), 640);
  EXPECT_EQ(width_of_maps(0, 352, 264), 352);
  EXPECT_EQ(width_of_maps(0, 752, 480), 376);
  EXPECT_EQ(width_of_maps(0, 1920, 1200), 640);
  EXPECT_EQ(width_of_maps(1, 752, 480), 752);
  EXPECT_EQ(width_of_maps(4, 640, 480), 160);
}

}  // namespace
}  // namespace corvid
