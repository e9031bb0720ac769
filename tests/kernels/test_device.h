#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <memory>

#include "kernels/device.h"

namespace corvid {

/// The device of these tests: $CORVID_TEST_DEVICE (as for --device), or the CPU.
inline std::shared_ptr<Device> test_device() {
  // Never destroyed: at the program's end the driver may be gone before it.
  static const auto* const device = [] {
    const char* choice = std::getenv("CORVID_TEST_DEVICE");
    auto opened = Device::open(choice != nullptr ? choice : "cpu");
    if (!opened) throw std::runtime_error(opened.error().to_string());
    return new std::shared_ptr<Device>(*opened);
  }();
  return *device;
}

/// Makes a launcher, or fails the test with the reason.
template <class T, class... Arguments>
T make(Arguments&&... arguments) {
  auto made = T::create(test_device(), std::forward<Arguments>(arguments)...);
  if (!made) throw std::runtime_error(made.error().to_string());
  return std::move(*made);
}

}  // namespace corvid
