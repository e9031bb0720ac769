#include "kernels/device.h"

#include <gmock/gmock.h>

#include <numeric>

#include "kernels/buffer.h"
#include "kernels/test_device.h"

namespace corvid {
namespace {

using ::testing::HasSubstr;

TEST(Device, IsListedAndOpenedByIndex) {
  const auto devices = list_devices();
  ASSERT_TRUE(devices) << devices.error().to_string();
  for (std::size_t i = 0; i < devices->size(); ++i) {
    EXPECT_EQ((*devices)[i].index, static_cast<int>(i));
    EXPECT_GT((*devices)[i].memory_bytes, 0U);
    EXPECT_GT((*devices)[i].compute_units, 0);
    const auto opened = Device::open(std::to_string(i));
    ASSERT_TRUE(opened) << opened.error().to_string();
    EXPECT_EQ((*opened)->info().name, (*devices)[i].name);
  }
}

TEST(Device, AutoPrefersAGpu) {
  const auto devices = list_devices();
  ASSERT_TRUE(devices);
  const bool any_gpu =
      std::any_of(devices->begin(), devices->end(), [](const auto& d) { return d.gpu; });
  const auto opened = Device::open("auto");
  ASSERT_TRUE(opened) << opened.error().to_string();
  EXPECT_EQ((*opened)->info().gpu, any_gpu);
}

TEST(Device, WrongChoicesSayWhatThereIs) {
  for (const char* choice : {"", "fast", "1x", "-1", "99", "cpu "}) {
    const auto opened = Device::open(choice);
    ASSERT_FALSE(opened) << choice;
    EXPECT_THAT(opened.error().hint, HasSubstr(test_device()->info().name)) << choice;
  }
}

TEST(Buffer, GrowsKeepsItsCapacityAndChecksBounds) {
  Buffer<int> buffer(test_device());
  EXPECT_EQ(buffer.size(), 0U);
  std::vector<int> values(1000);
  std::iota(values.begin(), values.end(), 7);
  buffer.upload(values);
  const std::size_t capacity = buffer.capacity();
  std::vector<int> part(10);
  buffer.download(part, 990);
  EXPECT_EQ(part.front(), 997);
  EXPECT_EQ(part.back(), 1006);
  EXPECT_THROW(buffer.download(part, 991), std::logic_error);
  EXPECT_THROW(buffer.download(part, std::size_t(-5)), std::logic_error);
  buffer.upload(std::span<const int>(values).first(3));
  EXPECT_EQ(buffer.size(), 3U);
  EXPECT_EQ(buffer.capacity(), capacity);
  EXPECT_THROW(buffer.download(part), std::logic_error);
  buffer.upload({});
  EXPECT_EQ(buffer.size(), 0U);
  buffer.download(std::span<int>());
}

TEST(Buffer, TooLargeIsADeviceFault) {
  Buffer<char> buffer(test_device());
  EXPECT_THROW(buffer.resize(std::size_t{1} << 60), DeviceFault);
  // And it can still be used.
  const char one = 42;
  buffer.upload({&one, 1});
  char back = 0;
  buffer.download({&back, 1});
  EXPECT_EQ(back, 42);
}

TEST(Buffer, LanesDoNotDisturbEachOther) {
  Buffer<int> a(test_device()), b(test_device());
  const std::vector<int> ones(5000, 1), twos(5000, 2);
  a.upload(ones, Lane::tracking);
  b.upload(twos, Lane::mapping);
  std::vector<int> back(5000);
  a.download(back, 0, Lane::tracking);
  EXPECT_EQ(back, ones);
  b.download(back, 0, Lane::mapping);
  EXPECT_EQ(back, twos);
}

}  // namespace
}  // namespace corvid
