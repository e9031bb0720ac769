#pragma once

#include <algorithm>
#include <cstddef>

#include "kernels/device.h"

// How launchers of this room start kernels. OpenCL's exceptions pass through: wrap in on_device().
namespace corvid {

template <class... Arguments>
void set_arguments(cl::Kernel& kernel, const Arguments&... arguments) {
  cl_uint index = 0;
  (kernel.setArg(index++, arguments), ...);
}

[[nodiscard]] constexpr int divide_up(int a, int b) { return (a + b - 1) / b; }

/// `columns` x `rows` work-items. A CPU gets one work-group per row, which PoCL runs as a loop on
/// one thread; a GPU gets 32 x 8 tiles, rounded up: kernels check their bounds.
inline void launch_rows(const Device& device, Lane lane, const cl::Kernel& kernel, int columns,
                        int rows) {
  const auto size = [](int n) { return static_cast<cl::size_type>(n); };
  if (device.info().gpu) {
    device.queue(lane).enqueueNDRangeKernel(
        kernel, cl::NullRange,
        cl::NDRange(size(divide_up(columns, 32) * 32), size(divide_up(rows, 8) * 8)),
        cl::NDRange(32, 8));
    return;
  }
  // Few work-group shapes: PoCL compiles each kernel again for every local size.
  constexpr int kGroup = 16;
  device.queue(lane).enqueueNDRangeKernel(
      kernel, cl::NullRange, cl::NDRange(size(divide_up(columns, kGroup) * kGroup), size(rows)),
      cl::NDRange(kGroup, 1));
}

/// `count` independent work-items that each have much to do: on a CPU one per work-group.
/// Rounded up on a GPU: kernels check their bounds. Global ids begin at `first`.
inline void launch_items(const Device& device, Lane lane, const cl::Kernel& kernel, int count,
                         std::size_t first = 0) {
  const int group = device.info().gpu ? 64 : 1;
  device.queue(lane).enqueueNDRangeKernel(
      kernel, cl::NDRange(first),
      cl::NDRange(static_cast<cl::size_type>(divide_up(count, group) * group)),
      cl::NDRange(static_cast<cl::size_type>(group)));
}

/// Rows of `width` pixels that one work-item of a CPU makes where it makes a band of rows: a few
/// bands per core, so that a busy core does not keep the others waiting, but none with less work
/// than it costs to wake a core.
[[nodiscard]] inline int band_rows(const Device& device, int width, int height, int min_px) {
  constexpr int kBandsPerUnit = 4;
  return std::max(divide_up(height, kBandsPerUnit * std::max(device.info().compute_units, 1)),
                  divide_up(min_px, width));
}

}  // namespace corvid
